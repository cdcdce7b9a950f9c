"""A plain folder: `images/`, `camera.yaml`, and where there are any, `times.csv` and `groundtruth.tum`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sequence import Ground, Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.sequences.calibration import read_calibration
from fvslam_graph.sequences.files import image_files, stamps_in_names
from fvslam_graph.sequences.ground import UAV_TILT, altimeter_readings, level_ground
from fvslam_graph.sequences.images import ImageFiles
from fvslam_graph.sequences.tables import (
    MAX_RATE,
    MIN_RATE,
    even_stamps,
    read_table,
    require_increasing,
    to_numbers,
)

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
    times = path / "times.csv"
    ground = None
    if times.exists():
        paths, stamps, ground, notes = _listed(times)
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


def _listed(times: Path) -> tuple[list[Path], NDArray[np.float64], Ground | None, tuple[str, ...]]:
    """Images, stamps and heights as `times.csv` lists them, and notes."""
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
    above, resolution, notes = altimeter_readings(heights, str(times))
    if not np.isfinite(above).any():
        return paths, stamps, None, notes
    ground = level_ground(above, UAV_TILT, "times.csv height_m")
    return paths, stamps, replace(ground, height_sigma=resolution), notes
