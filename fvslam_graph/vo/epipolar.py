"""Viewing rays, and how far a point is from the line on which another view has it."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.tracks import Tracks, variances_along

Rays = NDArray[np.float64]


def rays(camera: Camera, pixels: NDArray[np.float64]) -> Rays:
    """Viewing rays (N, 3) of pixels (N, 2), with z = 1."""
    towards = np.ones((len(pixels), 3))
    towards[:, :2] = camera.normalize(pixels)
    return towards


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
        return cls(rays(camera, tracks.keyframe), rays(camera, tracks.current), camera.fx, tracks.covariances)


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
    """How the distances of `epipolar_distance` change with the calibration, (N, 2), pixels.

    With the logarithm of the focal length, and with k1: the ray (x, y, 1) of a pixel is (x, y) / (1 + k1 (x^2 + y^2))
    in truth, which is OpenCV's k1 as long as it is small. Distances stay those in the images as they are.

    Args:
        matched, rotation, direction: As there.
    """
    previous, current = matched.previous, matched.current
    essential: NDArray[np.float64] = gtsam.SO3.Hat(direction) @ rotation.matrix()
    line = previous @ essential
    normal, foot, weight, distance = _perpendicular(line, matched)
    squares = [(seen[:, :2] ** 2).sum(axis=1) for seen in (previous, current)]
    across = (normal * current[:, :2]).sum(axis=1)
    columns = []
    for bends, stretch in (((1.0, 1.0), 1.0), (squares, squares[1] + 2 * across**2)):
        J_previous, J_current = (
            -seen[:, :2] * np.reshape(bend, (-1, 1)) for seen, bend in zip((previous, current), bends, strict=True)
        )
        J_line = J_previous @ essential[:2]
        moved = (J_line[:, :2] * foot).sum(axis=1) + J_line[:, 2] + (line[:, :2] * J_current).sum(axis=1)
        columns.append(weight * moved + distance * stretch)
    return np.column_stack(columns)


def _perpendicular(
    line: NDArray[np.float64], matched: MatchedRays
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The way from lines (N, 3) to points: normal and foot (N, 2), pixels per unit of line . point, and the distance.

    Seen from the foot of the perpendicular, it does not matter how the normal turns.
    """
    length = np.maximum(np.hypot(line[:, 0], line[:, 1]), 1e-9)  # a point on the epipole has no line
    normal = line[:, :2] / length[:, None]
    off = (line * matched.current).sum(axis=1)
    weight = matched.focal / length
    if matched.covariances is not None:
        weight = weight / np.sqrt(variances_along(normal, matched.covariances))
    return normal, matched.current[:, :2] - (off / length)[:, None] * normal, weight, off * weight
