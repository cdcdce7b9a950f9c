"""A plain folder: `images/`, `camera.yaml`, and where there are any, `times.csv` and `groundtruth.tum`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.sequences.calibration import read_calibration
from fvslam_graph.sequences.files import image_files, stamps_in_names
from fvslam_graph.sequences.images import ImageFiles
from fvslam_graph.sequences.tables import MAX_RATE, MIN_RATE, even_stamps
from fvslam_graph.sequences.times import TIMES, read_times

FORMAT = "folder"
LAYOUT = "images/ and camera.yaml"

DEFAULT_RATE = 30.0  # Hz


def matches(path: Path) -> bool:
    """Whether this folder has images in the plain layout."""
    return (path / "images").is_dir()


def read(path: Path) -> Sequence:
    """Open a folder.

    `times.csv` has a header and the columns `filename`, `timestamp_s` and, optionally, `height_m`: the camera's height
    above the ground in metres. Without it the images are taken in natural order, `rate` of them a second as
    `camera.yaml` says, or where it does not, at the stamps that their names are.
    """
    source = path / "camera.yaml"
    calibration = read_calibration(source)
    camera = calibration.camera
    times = path / TIMES
    ground = None
    if times.exists():
        listed = read_times(times, ("filename", "timestamp_s"))
        paths = [path / "images" / name for name in listed.names or ()]
        stamps, ground, notes = listed.stamps, listed.ground, listed.notes
    else:
        paths = image_files(path / "images")
        if not paths:
            raise SequenceError(f"{path / 'images'} holds no images")
        if calibration.rate is not None and not MIN_RATE <= calibration.rate <= MAX_RATE:
            raise SequenceError(
                f"{source}: the rate must be {MIN_RATE:g} to {MAX_RATE:g} images a second, not {calibration.rate:g}"
            )
        stamps, note = _unlisted(paths, calibration.rate)
        notes = (f"times.csv is missing, {note}",)

    images = ImageFiles(paths)
    truth = path / "groundtruth.tum"
    return Sequence(
        name=path.name,
        format=FORMAT,
        camera=camera.undistorted(),
        stamps=stamps,
        load=images.loader(camera, source),
        ground_truth=Trajectory.read_tum(truth) if truth.is_file() else None,
        ground=ground,
        notes=notes + calibration.notes + images.notes(camera),
    )


def _unlisted(paths: list[Path], rate: float | None) -> tuple[NDArray[np.float64], str]:
    """Stamps, (N,) seconds, and where they come from."""
    if rate is None and (told := stamps_in_names(paths)) is not None:
        return told[0], f"the images' names are taken as stamps in {told[1]}"
    source = "assumed" if rate is None else "as camera.yaml says"
    rate = rate or DEFAULT_RATE
    return even_stamps(len(paths), rate), f"the rate is {rate:g} Hz, {source}"
