"""KITTI odometry benchmark: rectified gray images, `calib.txt`, `times.txt`, poses in a folder beside the sequences.

Geiger, Lenz, Urtasun, "Are we ready for autonomous driving?", CVPR 2012.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.sequences.base import Sequence
from fvslam_graph.sequences.calibration import projection_camera
from fvslam_graph.sequences.files import first_image, missing_note, numbered_images, only_one, open_images
from fvslam_graph.sequences.ground import kitti_ground
from fvslam_graph.sequences.tables import CalibrationText, even_stamps, read_stamps, require_rows
from fvslam_graph.trajectory import Trajectory

FORMAT = "kitti-odometry"
LAYOUT = "image_0/ and calib.txt, or sequences/NN/ with them"

RATE = 10.0  # Hz, where there is no times.txt


def matches(path: Path) -> bool:
    """Whether this is a sequence's folder, or one that holds sequences."""
    return bool(_sequence_folders(path))


def read(path: Path) -> Sequence:
    """Open sequences/NN, or the benchmark's root where it has just one sequence."""
    folder = only_one(path, _sequence_folders(path), "sequence")
    files = numbered_images(folder / "image_0")
    indices = range(min(files), max(files) + 1)
    paths = [files.get(index) for index in indices]
    stamps, notes = _stamps(folder / "times.txt", max(files))

    calibration = CalibrationText(folder / "calib.txt")
    height, width = first_image(paths)[1].shape
    camera = projection_camera(calibration, "P0", (width, height))

    ground_truth, pose_notes = _ground_truth(folder.parent.parent / "poses" / f"{folder.name}.txt", stamps)
    return Sequence(
        name=f"kitti_{folder.name}",
        format=FORMAT,
        camera=camera,
        stamps=stamps[indices.start : indices.stop],
        load=open_images(paths, camera, calibration.path),
        ground_truth=ground_truth,
        ground=kitti_ground(len(paths)),
        notes=notes + pose_notes + missing_note(paths),
    )


def _sequence_folders(path: Path) -> list[Path]:
    if (path / "image_0").is_dir():
        return [path]
    return sorted(image_folder.parent for image_folder in [*path.glob("sequences/*/image_0"), *path.glob("*/image_0")])


def _stamps(path: Path, last: int) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Seconds of each frame, by its number, and notes."""
    if not path.is_file():
        return even_stamps(last + 1, RATE), ("times.txt is missing, 10 Hz is assumed",)
    stamps = read_stamps(path)
    require_rows(path, len(stamps), last)
    notes = (f"times.txt has {len(stamps)} stamps, the last image is number {last}",) if len(stamps) > last + 1 else ()
    return stamps, notes


def _ground_truth(path: Path, stamps: NDArray[np.float64]) -> tuple[Trajectory | None, tuple[str, ...]]:
    if not path.is_file():
        return None, ()
    truth = Trajectory.read_kitti(path)
    notes = (f"{path.name} has {truth.rows} poses for {len(stamps)} stamps",) if truth.rows != len(stamps) else ()
    truth = truth.between(0, len(stamps) - 1)
    return replace(truth, stamps=stamps[truth.stamps.astype(int)], rows=None), notes
