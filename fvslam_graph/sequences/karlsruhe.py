"""Karlsruhe sequences, the format of LIBVISO2's demo: rectified `I1_NNNNNN.png`, `calib.txt`, `insdata.txt`.

Geiger, Ziegler, Stiller, "StereoScan: Dense 3d Reconstruction in Real-time", IV 2011. The recordings publish no camera
height; LIBVISO2's demo assumes 1.6 m and a camera that looks down by 0.08 rad.
"""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import TrajectoryError
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.sequences.calibration import projection_camera
from fvslam_graph.sequences.files import numbered_images
from fvslam_graph.sequences.images import ImageFiles
from fvslam_graph.sequences.oxts import mercator, require_degrees
from fvslam_graph.sequences.tables import (
    CalibrationText,
    even_stamps,
    make_trajectory,
    read_table,
    require_increasing,
    require_rows,
    to_numbers,
)

FORMAT = "karlsruhe"
LAYOUT = "I1_*.png or I1_*.pgm and calib.txt"

RATE = 10.0  # Hz, where there is no insdata.txt
HEADING_DOUBT = 0.35  # radians between heading and direction of travel from which on a note says so
MOVING = 0.1  # metres between two rows that make a direction of travel


def matches(path: Path) -> bool:
    """Whether this is a folder with images of the left camera."""
    return any(path.glob("I1_*"))


def read(path: Path) -> Sequence:
    """Open a folder; stamps are seconds since the first image."""
    files = numbered_images(path, "I1_")
    indices = range(min(files), max(files) + 1)
    images = ImageFiles([files.get(index) for index in indices])
    ground_truth = None
    stamps = even_stamps(len(indices), RATE)
    notes: tuple[str, ...] = ("insdata.txt is missing, 10 Hz is assumed",)
    if (path / "insdata.txt").is_file():
        ground_truth, notes = _ins_data(path / "insdata.txt", indices)
        stamps = ground_truth.stamps[indices.start : indices.stop]

    calibration = CalibrationText(path / "calib.txt")
    camera = projection_camera(calibration, "P1_roi", images.size)
    return Sequence(
        name=path.name,
        format=FORMAT,
        camera=camera,
        stamps=stamps,
        load=images.loader(camera, calibration.path),
        ground_truth=ground_truth,
        notes=notes + images.notes(camera),
    )


def _ins_data(path: Path, indices: range) -> tuple[Trajectory, tuple[str, ...]]:
    """Approximate world_T_camera, stamped in seconds since the first image, and notes.

    A row for each image: time, latitude, longitude, altitude, x, y, z, roll, pitch, yaw. Approximated are: the camera
    sits at the GPS/IMU unit, looks straight along the heading, and is level (the unit's roll and pitch are rough).
    Whether yaw counts anticlockwise from east or clockwise from north is not documented, so the one that agrees with
    the direction of travel is taken.
    """
    rows = to_numbers(path, read_table(path))
    if rows.shape[1] != 10:
        raise TrajectoryError(f"{path} should have 10 columns (time, position, attitude), not {rows.shape[1]}")
    require_rows(path, len(rows), indices[-1])
    require_increasing(path, rows[:, 0])
    if not np.all(np.isfinite(rows)):
        raise TrajectoryError(f"{path} holds a number that is not finite")
    for latitude, longitude in rows[:, 1:3]:
        require_degrees(path, latitude, longitude)
    stamps = rows[:, 0] - rows[indices.start, 0]

    positions = np.column_stack([mercator(rows[:, 1], rows[:, 2]), rows[:, 3]])
    heading, doubt = _heading(rows[:, 9], positions)
    notes: tuple[str, ...] = ()
    if doubt > HEADING_DOUBT:
        notes = (f"headings of insdata.txt differ from the direction of travel by {np.degrees(doubt):.0f} deg",)
    poses = [_level_pose(angle, position) for angle, position in zip(heading, positions, strict=True)]
    return make_trajectory(path, stamps, poses).from_origin(), notes


def _heading(yaw: NDArray[np.float64], positions: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Heading anticlockwise from east, (N,) radians, and its median distance from the direction of travel."""
    steps = np.diff(positions[:, :2], axis=0)
    moving = np.flatnonzero(np.linalg.norm(steps, axis=1) > MOVING)
    if not len(moving):
        return yaw, 0.0
    travel = np.arctan2(steps[moving, 1], steps[moving, 0])

    def distance(heading: NDArray[np.float64]) -> float:
        turned = heading[moving] - travel
        return float(np.median(np.abs(np.arctan2(np.sin(turned), np.cos(turned)))))

    heading = min((yaw, np.pi / 2 - yaw), key=distance)
    return heading, distance(heading)


def _level_pose(heading: float, position: NDArray[np.float64]) -> gtsam.Pose3:
    """A level camera in an east-north-up world that looks along the heading."""
    c, s = np.cos(heading), np.sin(heading)
    right, down, forward = (s, -c, 0.0), (0.0, 0.0, -1.0), (c, s, 0.0)
    return gtsam.Pose3(gtsam.Rot3(np.column_stack([right, down, forward])), position)
