"""Landmarks as inverse depths and as points, and how one becomes the other.

A landmark in inverse depth is (x, y, z, azimuth, elevation, inverse depth): the camera centre that saw it first (its
anchor), the direction in which it was seen and the inverse of its distance from there. All are expressed in the present
camera. Source: Civera, Davison, Montiel, "Inverse depth parametrization for monocular SLAM", IEEE T-RO 24(5), 2008.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MIN_INVERSE_DEPTH = 1e-9  # 1/m, beyond which distances are not computed


def direction(azimuth: Array, elevation: Array) -> tuple[Array, Array]:
    """Unit vectors (N, 3) and their Jacobian (N, 3, 2); azimuth is to the right, elevation upwards, radians."""
    sin_a, cos_a, sin_e, cos_e = np.sin(azimuth), np.cos(azimuth), np.sin(elevation), np.cos(elevation)
    unit, J_angles = np.empty((len(azimuth), 3)), np.zeros((len(azimuth), 3, 2))
    unit[:, 0], unit[:, 1], unit[:, 2] = cos_e * sin_a, -sin_e, cos_e * cos_a
    J_angles[:, 0, 0], J_angles[:, 2, 0] = unit[:, 2], -unit[:, 0]
    J_angles[:, 0, 1], J_angles[:, 1, 1], J_angles[:, 2, 1] = -sin_e * sin_a, -cos_e, -sin_e * cos_a
    return unit, J_angles


def angles(vectors: Array) -> tuple[Array, Array]:
    """Azimuth and elevation (N, 2) of vectors (N, 3) of any length, and their Jacobian (N, 2, 3)."""
    x, y, z = vectors.T
    level = np.hypot(x, z)
    square = level**2 + y**2
    jacobian = np.zeros((len(vectors), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 0, 2] = z / level**2, -x / level**2
    jacobian[:, 1, 0], jacobian[:, 1, 2] = x * y / (level * square), y * z / (level * square)
    jacobian[:, 1, 1] = -level / square
    return np.column_stack([np.arctan2(x, z), np.arctan2(-y, level)]), jacobian


def scaled_points(inverse: Array) -> tuple[Array, Array]:
    """Landmarks (M, 6) as points times their inverse depth, (M, 3), which exist at infinity too; Jacobian (M, 3, 6)."""
    unit, J_angles = direction(inverse[:, 3], inverse[:, 4])
    jacobian = np.zeros((len(inverse), 3, 6))
    jacobian[:, :, :3] = inverse[:, 5, None, None] * np.eye(3)
    jacobian[:, :, 3:5] = J_angles
    jacobian[:, :, 5] = inverse[:, :3]
    return inverse[:, 5, None] * inverse[:, :3] + unit, jacobian


def to_points(inverse: Array) -> tuple[Array, Array]:
    """Landmarks (M, 6) as points (M, 3), metres, and their Jacobian (M, 3, 6); at infinity they are far away."""
    unit, J_angles = direction(inverse[:, 3], inverse[:, 4])
    depth = 1 / np.maximum(inverse[:, 5], _MIN_INVERSE_DEPTH)
    jacobian = np.zeros((len(inverse), 3, 6))
    jacobian[:, :, :3] = np.eye(3)
    jacobian[:, :, 3:5] = depth[:, None, None] * J_angles
    jacobian[:, :, 5] = -(depth**2)[:, None] * unit
    return inverse[:, :3] + depth[:, None] * unit, jacobian


def points_seen_from(points: Array, rotation: Array, translation: Array) -> tuple[Array, Array, Array]:
    """Points or anchors (N, 3) in a camera that moved.

    Args:
        points: (N, 3) in the previous camera, metres.
        rotation, translation: (3, 3) and (3,) of prev_T_cur.

    Returns:
        (N, 3) in the current camera, its Jacobians by the right perturbation of prev_T_cur (N, 3, 6) and by `points`
        (N, 3, 3).
    """
    seen = (points - translation) @ rotation
    J_motion = np.zeros((len(points), 3, 6))
    J_motion[:, :, :3], J_motion[:, :, 3:] = hat(seen), -np.eye(3)
    return seen, J_motion, np.broadcast_to(rotation.T, (len(points), 3, 3))


def inverse_depth_seen_from(inverse_depth: Array, rotation: Array) -> tuple[Array, Array, Array]:
    """Azimuths, elevations and inverse depths (M, 3) in a camera that moved; only its rotation matters.

    Args:
        inverse_depth: (M, 3) in the previous camera.
        rotation: (3, 3) of prev_T_cur.

    Returns:
        (M, 3) in the current camera, its Jacobians by the right perturbation of prev_T_cur (M, 3, 6) and by the
        arguments (M, 3, 3).
    """
    unit, J_angles = direction(inverse_depth[:, 0], inverse_depth[:, 1])
    seen = unit @ rotation
    pointing, J_seen = angles(seen)
    J_motion, J_inverse_depth = np.zeros((len(inverse_depth), 3, 6)), np.zeros((len(inverse_depth), 3, 3))
    J_motion[:, :2, :3] = J_seen @ hat(seen)
    J_inverse_depth[:, :2, :2] = J_seen @ rotation.T @ J_angles
    J_inverse_depth[:, 2, 2] = 1.0
    return np.column_stack([pointing, inverse_depth[:, 2]]), J_motion, J_inverse_depth


def linearity_index(inverse: Array, sigma: Array) -> Array:
    """How far from linear a landmark (M, 6) projects as a point, given the deviation (M,) of its inverse depth.

    Below about 0.1 the error of a point is normally distributed as well (Civera, Davison, Montiel 2008, eq. 34).
    """
    unit, _ = direction(inverse[:, 3], inverse[:, 4])
    points, _ = to_points(inverse)
    distance = np.linalg.norm(points, axis=1)
    cosine = (unit * points).sum(axis=1) / distance
    spread = sigma / np.maximum(inverse[:, 5], _MIN_INVERSE_DEPTH) ** 2
    index: Array = 4 * spread / distance * np.abs(cosine)
    return index


def hat(vectors: Array) -> Array:
    """Matrices (N, 3, 3) of the cross product with vectors (N, 3)."""
    crosses = np.zeros((len(vectors), 3, 3))
    crosses[:, 2, 1], crosses[:, 0, 2], crosses[:, 1, 0] = vectors.T
    crosses[:, 1, 2], crosses[:, 2, 0], crosses[:, 0, 1] = -vectors.T
    return crosses
