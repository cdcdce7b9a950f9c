"""Viewing rays, and how far a point is from the line on which another view has it."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.camera import Camera

Rays = NDArray[np.float64]


def rays(camera: Camera, pixels: NDArray[np.float64]) -> Rays:
    """Viewing rays (N, 3) of pixels (N, 2), with z = 1."""
    normalized = camera.normalize(pixels)
    return np.column_stack([normalized, np.ones(len(normalized))])


def epipolar_distance(
    previous: Rays,
    current: Rays,
    rotation: gtsam.Rot3,
    direction: NDArray[np.float64],
    focal: float,
    covariances: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far current points are from the epipolar lines of the previous ones, (N,), and its Jacobian (N, 5).

    A tracker errs about the displacement from the previous image, so the distance is measured in the current one.

    Args:
        previous, current: (N, 3) rays, z = 1.
        rotation: prev_R_cur.
        direction: (3,) unit vector in the previous camera, from there to the current one.
        focal: Pixels.
        covariances: (N, 2, 2) as of Tracks; with them, a distance is as long as if it were a corner's.

    Returns:
        Pixels, and in the tangent of TwoView.
    """
    R = rotation.matrix()
    line = np.cross(previous, direction) @ R
    length = np.maximum(np.hypot(line[:, 0], line[:, 1]), 1e-9)  # a point on the epipole has no line
    normal = line[:, :2] / length[:, None]
    distance = (line * current).sum(axis=1) / length
    foot = current.copy()  # of the perpendicular: seen from there, it does not matter how the normal turns
    foot[:, :2] -= distance[:, None] * normal
    weight: NDArray[np.float64] = focal / length
    if covariances is not None:
        weight = weight / np.sqrt((normal * (covariances @ normal[:, :, None])[:, :, 0]).sum(axis=1))
    by_direction = np.cross(foot @ R.T, previous) @ gtsam.Unit3(direction).basis()
    return distance * length * weight, weight[:, None] * np.hstack([np.cross(foot, line), by_direction])
