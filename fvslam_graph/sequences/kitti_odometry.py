"""KITTI odometry benchmark: rectified images, `calib.txt`, `times.txt`, poses in a folder beside the sequences.

Geiger, Lenz, Urtasun, "Are we ready for autonomous driving?", CVPR 2012.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.sequences.calibration import projection_camera
from fvslam_graph.sequences.files import numbered_images, only_one
from fvslam_graph.sequences.ground import kitti_ground
from fvslam_graph.sequences.images import ImageFiles
from fvslam_graph.sequences.tables import CalibrationText, even_stamps, read_stamps, require_rows

FORMAT = "kitti-odometry"
LAYOUT = "image_0/ (or image_1, 2, 3) and calib.txt, or sequences/NN/ with them"

CAMERAS = (0, 1, 2, 3)  # the left gray one where it is there
RATE = 10.0  # Hz, where there is no times.txt


def matches(path: Path) -> bool:
    """Whether this is a sequence's folder, or one that holds sequences."""
    return bool(_sequence_folders(path))


def read(path: Path) -> Sequence:
    """Open sequences/NN, or the benchmark's root where it has just one sequence."""
    folder = only_one(path, _sequence_folders(path), "sequence")
    which = next(which for which in CAMERAS if (folder / f"image_{which}").is_dir())
    files = numbered_images(folder / f"image_{which}")
    indices = range(min(files), max(files) + 1)
    images = ImageFiles([files.get(index) for index in indices])
    stamps, notes = _stamps(folder / "times.txt", max(files))
    if which != CAMERAS[0]:
        notes += (f"image_0 is missing, image_{which} is used",)

    calibration = CalibrationText(folder / "calib.txt")
    camera = projection_camera(calibration, f"P{which}", images.size)
    ground_truth, pose_notes = _ground_truth(folder.parent.parent / "poses" / f"{folder.name}.txt", stamps)
    if ground_truth is not None and which != CAMERAS[0]:
        ground_truth = _of_camera(ground_truth, calibration.numbers(f"P{which}", 3, 4))
    return Sequence(
        name=folder.name,
        format=FORMAT,
        camera=camera,
        stamps=stamps[indices.start : indices.stop],
        load=images.loader(camera, calibration.path),
        ground_truth=ground_truth,
        ground=kitti_ground(len(indices)),
        notes=notes + pose_notes + images.notes(camera),
    )


def _sequence_folders(path: Path) -> list[Path]:
    if any((path / f"image_{which}").is_dir() for which in CAMERAS):
        return [path]
    return sorted({folder.parent for pattern in ("sequences/*", "*") for folder in path.glob(f"{pattern}/image_[0-3]")})


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


def _of_camera(truth: Trajectory, P: NDArray[np.float64]) -> Trajectory:
    """Poses of camera 0 as those of the camera with projection matrix P (3, 4), whose first frame is the world."""
    # P = K [I | t]: t takes points of camera 0 to this one.
    camera_T_0 = gtsam.Pose3(gtsam.Rot3(), np.linalg.solve(P[:, :3], P[:, 3]))
    poses = [camera_T_0 * pose * camera_T_0.inverse() for pose in truth.poses]
    return replace(truth, poses=tuple(poses))
