"""TUM RGB-D recordings: `rgb.txt` lists the images, `groundtruth.txt` holds the poses of the colour camera.

Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012.
"""

from __future__ import annotations

from pathlib import Path

from fvslam_graph.core.camera import Camera, Distortion
from fvslam_graph.core.errors import CameraError
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.sequences.calibration import Calibration, read_calibration
from fvslam_graph.sequences.images import ImageFiles
from fvslam_graph.sequences.tables import read_listing, require_increasing, to_numbers

FORMAT = "tum-rgbd"
LAYOUT = "rgb.txt"

# The benchmark publishes the calibration on its page, not in the recordings. Freiburg 3 comes undistorted.
FREIBURG_CAMERAS = {
    "freiburg1": Camera(
        640, 480, 517.3, 516.5, 318.6, 255.3, Distortion.RADTAN, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
    ),
    "freiburg2": Camera(
        640, 480, 520.9, 521.0, 325.1, 249.7, Distortion.RADTAN, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)
    ),
    "freiburg3": Camera(640, 480, 535.4, 539.2, 320.1, 247.6),
}


def matches(path: Path) -> bool:
    """Whether this folder has a list of colour images."""
    return (path / "rgb.txt").is_file()


def read(path: Path) -> Sequence:
    """Open a recording; its calibration is that of its `camera.yaml`, or the published one of its name."""
    listing = path / "rgb.txt"
    rows = [_colour(row) for row in read_listing(listing, (2, 4))]
    stamps = to_numbers(listing, [[stamp] for stamp, _ in rows])[:, 0]
    require_increasing(listing, stamps)
    images = ImageFiles([path / name for _, name in rows])

    source, calibration = _calibration(path)
    camera = calibration.camera
    truth = path / "groundtruth.txt"
    return Sequence(
        name=path.name,
        format=FORMAT,
        camera=camera.undistorted(),
        stamps=stamps,
        load=images.loader(camera, source),
        ground_truth=Trajectory.read_tum(truth) if truth.is_file() else None,
        notes=calibration.notes + images.notes(camera),
    )


def _colour(row: list[str]) -> tuple[str, str]:
    """Stamp and file of the colour image of a row, in which the benchmark's associate.py may have put a depth image."""
    stamp, file = row[2:] if len(row) == 4 and row[3].startswith("rgb") else row[:2]
    return stamp, file


def _calibration(path: Path) -> tuple[Path | str, Calibration]:
    """Where the calibration comes from, and the calibration."""
    own = path / "camera.yaml"
    if own.exists():
        return own, read_calibration(own)
    for name, camera in FREIBURG_CAMERAS.items():
        if name in str(path).lower():
            return f"the published calibration of {name}", Calibration(camera)
    raise CameraError(
        f"{path} has no camera.yaml, and its name does not say whose calibration to take "
        f"({', '.join(FREIBURG_CAMERAS)})"
    )
