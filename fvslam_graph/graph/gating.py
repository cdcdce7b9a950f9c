"""Whether motions of odometry contradict the landmarks of the graph."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.gates import chi2_gate
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.features.ransac import RansacOptions, absolute_pose

Array = NDArray[np.float64]

CONTRADICTION_GATE = chi2_gate(0.999, 2)
MIN_LANDMARKS = 12  # that agree on where the camera is,
MIN_AGREEING_SHARE = 0.5  # and of those that are seen
MAX_CONDITION = 1e14
MIN_DEPTH = 0.05  # metres in front of a camera
WIDTH = 5.0  # standard deviations of a pixel, within which a landmark agrees


def contradiction(
    expected: GaussianPose, points: Array, pixels: Array, camera: Camera, sigma: float, seed: int
) -> GaussianPose | None:
    """Where landmarks have the camera, as if they were in their places; None where odometry allows for that.

    Odometry is contradicted where most landmarks are seen far from where it expects them, and yet agree with each other
    on another pose.

    Args:
        expected: world_T_camera by odometry, with the covariance of its motions.
        points: (N, 3) of landmarks, in the world, metres; NaN where that is not known.
        pixels: (N, 2) where they are seen.
        camera: That these points were made with.
        sigma: Pixels, along each axis.
        seed: Of the RANSAC.
    """
    known = np.isfinite(points).all(axis=1)
    points, pixels = points[known], pixels[known]
    if len(points) < MIN_LANDMARKS:
        return None
    innovation, J_pose = _innovations(expected.mean, points, pixels, camera)
    S = J_pose @ expected.covariance @ J_pose.mT + (WIDTH * sigma) ** 2 * np.eye(2)
    distances = (innovation * np.linalg.solve(S, innovation[:, :, None])[:, :, 0]).sum(axis=1)
    if float(np.median(distances)) < CONTRADICTION_GATE:
        return None
    square = replace(camera.undistorted(), fy=camera.fx, cx=0.0, cy=0.0)  # pixels as far apart in both directions
    options = RansacOptions(WIDTH * sigma, WIDTH * sigma / 2, seed)
    found = absolute_pose(points, camera.fx * camera.normalize(pixels), square, options)
    if found is None:
        return None
    pose, agree = found
    if agree.sum() < max(MIN_LANDMARKS, MIN_AGREEING_SHARE * len(points)):
        return None
    _, J_pose = _innovations(pose, points[agree], pixels[agree], camera)
    information = (J_pose.mT @ J_pose).sum(axis=0) / sigma**2
    return GaussianPose(pose, np.linalg.inv(information)) if np.linalg.cond(information) < MAX_CONDITION else None


def _innovations(pose: gtsam.Pose3, points: Array, pixels: Array, camera: Camera) -> tuple[Array, Array]:
    """How far pixels are from where a camera would see points, (N, 2), and the derivative of that place, (N, 2, 6)."""
    x, y, z = ((points - pose.translation()) @ pose.rotation().matrix()).T
    near = 1 / np.maximum(z, MIN_DEPTH)  # what is behind the camera is far from where it is seen
    x, y, zero = x * near, y * near, np.zeros_like(z)
    # A pose perturbed by (w, v) on the right sees the point at p + [p]x w - v.
    J_pose = camera.fx * np.stack(
        [
            np.stack([x * y, -(1 + x * x), y, -near, zero, near * x], axis=1),
            np.stack([1 + y * y, -x * y, -x, zero, -near, near * y], axis=1),
        ],
        axis=1,
    )
    return camera.fx * (camera.normalize(pixels) - np.column_stack([x, y])), J_pose
