"""Rotation between two views whose parallax tells no direction of travel."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.quick import median

_ROTATION_ITERATIONS = 4
_SMALL = 3e-4  # rad, of the distance from an epipolar plane
_MOST, _NOISE = 0.8, 2.0  # of the points; times what half of them have by noise, these have at most (1.5 if normal)


def fit_rotation(
    previous: NDArray[np.float64], current: NDArray[np.float64], focal: float
) -> tuple[gtsam.Rot3, NDArray[np.float64]]:
    """The rotation prev_R_cur that best explains matched rays, and the image motion that it leaves unexplained.

    Least absolute residuals by reweighting (so that near points and outliers do not decide), each step solved in closed
    form (Kabsch 1976).

    Args:
        previous, current: (N, 3) rays, z = 1, N >= 3.
        focal: Pixels.

    Returns:
        The rotation, and (N,) the residual image motion, pixels.
    """
    a = previous / np.linalg.norm(previous, axis=1, keepdims=True)
    b = current / np.linalg.norm(current, axis=1, keepdims=True)
    weight = np.ones(len(a))
    for _ in range(_ROTATION_ITERATIONS):
        rotation = gtsam.Rot3.ClosestTo((a * weight[:, None]).T @ b)
        off = a - b @ rotation.matrix().T
        residual = focal * np.sqrt(np.vecdot(off, off))
        weight = 1 / np.maximum(residual, 0.1)
    return rotation, residual


def motion_given_rotation(
    rotation: gtsam.Rot3, previous: NDArray[np.float64], current: NDArray[np.float64]
) -> gtsam.Pose3:
    """The motion prev_T_cur whose rotation most points tell, its direction of travel by what that leaves unexplained.

    Where most points are on the horizon, few samples of five tell a direction. Least absolute distances from epipolar
    planes by reweighting, each step the smallest eigenvector; points come out ahead as a rule.

    Args:
        rotation: prev_R_cur, see `fit_rotation`.
        previous, current: (N, 3) rays, z = 1.

    Returns:
        With a baseline of 1.
    """
    a = previous / np.linalg.norm(previous, axis=1, keepdims=True)
    b = current / np.linalg.norm(current, axis=1, keepdims=True) @ rotation.matrix().T
    normals = np.cross(a, b)
    weight = np.ones(len(a))
    for _ in range(_ROTATION_ITERATIONS):
        _, axes = np.linalg.eigh((normals * weight[:, None]).T @ normals)
        direction = axes[:, 0]
        weight = 1 / np.maximum(np.abs(normals @ direction), _SMALL)
    towards = float(((b - a) @ direction).sum()) < 0  # what is ahead seems to go the other way
    return gtsam.Pose3(rotation, direction if towards else -direction)


def near_parallax(unexplained: NDArray[np.float64]) -> float:
    """Pixels of parallax of what is near enough to show a translation.

    Half of the points may be on the horizon, whatever the camera does: the nearest fifth has its say. That is more than
    are wrong matches.

    Args:
        unexplained: (N,) image motion that no rotation explains, pixels.
    """
    nearest = int(_MOST * (len(unexplained) - 1))
    return max(median(unexplained), float(np.partition(unexplained, nearest)[nearest]) / _NOISE)
