"""Open recordings of a format of your own: frames.csv with stamp and file of each image, and focal.txt in pixels.

In a package, the entry point `my-frames = "mypkg:MyFrames"` of the group `fvslam_graph.formats` makes it known to all
commands; without one, `fvslam run PATH --format mypkg:MyFrames` does.
"""

import tempfile
from pathlib import Path

import cv2
import numpy as np

import fvslam_graph
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.testing import rendered


class MyFrames:
    FORMAT, LAYOUT = "my-frames", "frames.csv with stamp,file and focal.txt"

    def matches(self, path):
        return (path / "frames.csv").is_file()

    def read(self, path):
        stamps, files = zip(*(line.split(",") for line in (path / "frames.csv").read_text().split()), strict=True)
        images = [cv2.imread(str(path / file), cv2.IMREAD_GRAYSCALE) for file in files]
        (height, width), focal = images[0].shape, float((path / "focal.txt").read_text())
        camera = fvslam_graph.Camera(width, height, focal, focal, width / 2, height / 2)
        return Sequence(path.name, self.FORMAT, camera, np.array(stamps, float), images.__getitem__)


with tempfile.TemporaryDirectory() as folder:
    flight = rendered("uav", frames=12, size="320x240")
    lines = [f"{f.stamp},{f.index}.png\n" for f in flight if cv2.imwrite(f"{folder}/{f.index}.png", f.image)]
    Path(folder, "frames.csv").write_text("".join(lines))
    Path(folder, "focal.txt").write_text(str(flight.camera.fx))
    run = fvslam_graph.run(open_sequence(folder, format=f"{__name__}:MyFrames"))
    print(f"{run.info['format']}: {run.online.path_length:.1f} m, in a scale of its own")
