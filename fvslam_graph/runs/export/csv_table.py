"""A table for spreadsheets, pandas and MATLAB."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np

from fvslam_graph.runs.export.poses import ExportedPoses

TANGENT = ("rx", "ry", "rz", "tx", "ty", "tz")  # rad, m
CSV_COLUMNS = (
    *("frame", "stamp", "status", "x", "y", "z", "qx", "qy", "qz", "qw"),
    *(f"cov_{a}_{b}" for a, b in product(TANGENT, TANGENT)),
)


def write(path: Path, poses: ExportedPoses) -> tuple[str, ...]:
    """Write a line a pose: its position (m), its quaternion, and its covariance row by row.

    The covariance is that of the package: in the tangent of the pose, along the axes of the camera, rotation (rad)
    before translation (m). Its cells are empty where it is not known.
    """
    count = len(poses.frames)
    covariances = np.full((count, 36), np.nan) if poses.covariances is None else poses.covariances.reshape(-1, 36)
    numbers = np.hstack([poses.trajectory.positions, poses.quaternions, covariances])
    lines = [",".join(CSV_COLUMNS)]
    for frame, stamp, status, row in zip(poses.frames, poses.trajectory.stamps, poses.statuses, numbers, strict=True):
        cells = ("" if np.isnan(number) else f"{number:.17g}" for number in row)
        lines.append(f"{frame},{stamp:.9f},{status},{','.join(cells)}")
    path.write_text("\n".join(lines) + "\n")
    return ()
