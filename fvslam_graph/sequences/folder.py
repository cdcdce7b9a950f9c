"""A plain folder: `images/`, `camera.yaml`, and where there are any, `times.csv` and `groundtruth.tum`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.errors import SequenceError
from fvslam_graph.sequences.base import Ground, Sequence
from fvslam_graph.sequences.calibration import numbers, read_camera, read_yaml
from fvslam_graph.sequences.files import image_files, missing_note, open_images
from fvslam_graph.sequences.ground import UAV_TILT, level_ground
from fvslam_graph.sequences.tables import even_stamps, read_table, require_increasing, to_numbers
from fvslam_graph.trajectory import Trajectory

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
    `camera.yaml` says.
    """
    calibration = path / "camera.yaml"
    camera = read_camera(calibration)
    times = path / "times.csv"
    ground = None
    if times.is_file():
        paths, stamps, ground = _listed(times)
        notes = missing_note(paths)
    else:
        paths = image_files(path / "images")
        if not paths:
            raise SequenceError(f"{path / 'images'} holds no images")
        content = read_yaml(calibration)
        rate = numbers(calibration, content, "rate", 1)[0] if "rate" in content else DEFAULT_RATE
        if rate <= 0:
            raise SequenceError(f"{calibration}: the rate must be positive, not {rate:g}")
        stamps = even_stamps(len(paths), rate)
        source = "as camera.yaml says" if "rate" in content else "assumed"
        notes = (f"times.csv is missing, the rate is {rate:g} Hz, {source}",)

    truth = path / "groundtruth.tum"
    return Sequence(
        name=path.name,
        format=FORMAT,
        camera=camera.undistorted(),
        stamps=stamps,
        load=open_images(paths, camera, calibration),
        ground_truth=Trajectory.read_tum(truth) if truth.is_file() else None,
        ground=ground,
        notes=notes,
    )


def _listed(times: Path) -> tuple[list[Path], NDArray[np.float64], Ground | None]:
    """Images, stamps and heights as `times.csv` lists them."""
    header, *rows = read_table(times, ",") or [[]]
    if "filename" not in header or "timestamp_s" not in header or not rows:
        raise SequenceError(f"{times} should have a header with filename and timestamp_s, and a row for each image")
    for number, row in enumerate(rows, 1):
        if len(row) != len(header):
            raise SequenceError(f"{times}: row {number} has {len(row)} values, the header has {len(header)}")
    columns = dict(zip(header, zip(*rows, strict=True), strict=True))

    paths = [times.parent / "images" / name for name in columns["filename"]]
    stamps = to_numbers(times, [[stamp] for stamp in columns["timestamp_s"]])[:, 0]
    require_increasing(times, stamps)
    heights = to_numbers(times, [[height or "nan"] for height in columns.get("height_m", ())]).ravel()
    return paths, stamps, _altimeter(heights)


def _altimeter(heights: NDArray[np.float64]) -> Ground | None:
    """The ground as a height reading knows it: no better than its smallest step, and not nearer than that."""
    known = np.unique(heights[np.isfinite(heights)])
    if not len(known):
        return None
    resolution = round(float(np.diff(known).min()), 6) if len(known) > 1 else 0.0
    ground = level_ground(np.maximum(heights, resolution), UAV_TILT, "times.csv height_m")
    return replace(ground, height_sigma=resolution)
