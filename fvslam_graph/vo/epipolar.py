"""Viewing rays, and how far a point is from the line on which another view has it."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.tracks import Tracks, variances_along

Rays = NDArray[np.float64]


@dataclass(frozen=True)
class MatchedRays:
    """N points seen in two views.

    Attributes:
        previous, current: (N, 3) rays, z = 1.
        focal: Pixels.
        covariances: (N, 2, 2) of the displacements, as in Tracks; None where all are those of corners.
    """

    previous: Rays
    current: Rays
    focal: float
    covariances: NDArray[np.float64] | None = None

    @classmethod
    def of(cls, camera: Camera, tracks: Tracks) -> MatchedRays:
        """The rays of tracks."""
        return cls(camera.rays(tracks.keyframe), camera.rays(tracks.current), camera.fx, tracks.covariances)


def epipolar_distance(
    matched: MatchedRays, rotation: gtsam.Rot3, direction: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far current points are from the epipolar lines of the previous ones, (N,), and its Jacobian (N, 5).

    A tracker errs about the displacement from the previous image, so the distance is measured in the current one.

    Args:
        matched: The points; by their covariances, a distance is as long as if it were a corner's.
        rotation: prev_R_cur.
        direction: (3,) unit vector in the previous camera, from there to the current one.

    Returns:
        Pixels, and in the tangent of RelativePose.
    """
    # A line is linear in the direction: with it come its derivatives along the two axes of the tangent.
    axes = np.column_stack([direction, gtsam.Unit3(direction).basis()])
    lines = matched.previous @ np.hstack([gtsam.SO3.Hat(axis) @ rotation.matrix() for axis in axes.T])
    line = lines[:, :3]
    _, foot, weight, distance = _perpendicular(line, matched)
    jacobian = np.empty((len(line), 5))
    (x, y), (a, b, c) = foot.T, line.T
    jacobian[:, 0], jacobian[:, 1], jacobian[:, 2] = y * c - b, a - x * c, x * b - y * a
    jacobian[:, 3] = lines[:, 3] * x + lines[:, 4] * y + lines[:, 5]
    jacobian[:, 4] = lines[:, 6] * x + lines[:, 7] * y + lines[:, 8]
    return distance, weight[:, None] * jacobian


def calibration_jacobian(
    matched: MatchedRays, rotation: gtsam.Rot3, direction: NDArray[np.float64]
) -> NDArray[np.float64]:
    """How the distances of `epipolar_distance` change with the calibration, (N, 7), pixels.

    With the logarithm of the focal length, and with OpenCV's k1, k2, principal point (in focal lengths), p1 and p2, as
    long as these are small: the ray (x, y, 1) of a pixel is (x, y) less its `bends` in truth. Distances stay those in
    the images as they are.

    Args:
        matched, rotation, direction: As there.
    """
    essential: NDArray[np.float64] = gtsam.SO3.Hat(direction) @ rotation.matrix()
    normal, foot, weight, distance = _perpendicular(matched.previous @ essential, matched)
    line = matched.previous @ essential[:, :2]
    J_line = bends(matched.previous) @ essential[:2]  # (7, N, 3)
    moved = np.vecdot(J_line[:, :, :2], foot) + J_line[:, :, 2] + np.vecdot(line, bends(matched.current))
    # How much longer distances become in the image: along the normal, bends grow so much.
    (x, y), (a, b) = matched.current[:, :2].T, normal.T
    square, across = x * x + y * y, (a * x + b * y) ** 2
    stretch = np.zeros_like(moved)
    stretch[0] = 1.0
    stretch[1], stretch[2] = square + 2 * across, square**2 + 4 * square * across
    stretch[5] = 2 * y * a * a + 4 * x * a * b + 6 * y * b * b
    stretch[6] = 6 * x * a * a + 4 * y * a * b + 2 * x * b * b
    changes: NDArray[np.float64] = (distance * stretch - weight * moved).T
    return changes


def bends(rays: Rays) -> NDArray[np.float64]:
    """How rays of pixels, (N, 2) or more, are off by one unit of each number of `calibration_jacobian`, (7, N, 2)."""
    x, y = rays[:, :2].T
    square = x * x + y * y
    one, zero = np.ones_like(x), np.zeros_like(x)
    off: NDArray[np.float64] = np.array(
        [
            [x, y],
            [square * x, square * y],
            [square**2 * x, square**2 * y],
            [one, zero],
            [zero, one],
            [2 * x * y, square + 2 * y * y],
            [square + 2 * x * x, 2 * x * y],
        ]
    ).swapaxes(1, 2)
    return off


def _perpendicular(
    line: NDArray[np.float64], matched: MatchedRays
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The way from lines (N, 3) to points: normal and foot (N, 2), pixels per unit of line . point, and the distance.

    Seen from the foot of the perpendicular, it does not matter how the normal turns.
    """
    length = np.maximum(np.hypot(line[:, 0], line[:, 1]), 1e-9)  # a point on the epipole has no line
    normal = line[:, :2] / length[:, None]
    off = np.vecdot(line, matched.current)
    weight = matched.focal / length
    if matched.covariances is not None:
        weight = weight / np.sqrt(variances_along(normal, matched.covariances))
    return normal, matched.current[:, :2] - (off / length)[:, None] * normal, weight, off * weight
