"""Whether motions of odometry contradict the landmarks of the graph."""

from __future__ import annotations

import gtsam
import numpy as np
import poselib
from numpy.typing import NDArray

from fvslam_graph.camera import Camera
from fvslam_graph.estimates import GaussianPose

Array = NDArray[np.float64]

GATE = 13.816  # 99.9 % quantile of the chi-square distribution with two degrees of freedom
MIN_LANDMARKS = 12  # that agree on where the camera is,
MIN_SHARE = 0.5  # and of those that are seen
WIDTH = 5.0  # standard deviations of a pixel, within which a landmark agrees


def contradiction(
    expected: GaussianPose, points: Array, pixels: Array, camera: Camera, sigma: float, seed: int
) -> gtsam.Pose3 | None:
    """Where landmarks have the camera, if that is elsewhere than odometry allows; else None.

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
    if len(points) < MIN_LANDMARKS or float(np.median(_innovations(expected, points, pixels, camera, sigma))) < GATE:
        return None
    square = camera.fx * camera.normalize(pixels)
    model = {"model": "SIMPLE_PINHOLE", "width": camera.width, "height": camera.height, "params": [camera.fx, 0, 0]}
    ransac = {"max_reproj_error": WIDTH * sigma, "seed": seed}
    found, info = poselib.estimate_absolute_pose(square, points, model, ransac, {})
    if sum(info["inliers"]) < max(MIN_LANDMARKS, MIN_SHARE * len(points)):
        return None
    return gtsam.Pose3(gtsam.Rot3(found.R), found.t).inverse()


def _innovations(expected: GaussianPose, points: Array, pixels: Array, camera: Camera, sigma: float) -> Array:
    """Squared Mahalanobis distances (N,) of pixels from where a pose expects them; infinite behind the camera."""
    x, y, z = (points - expected.mean.translation()).dot(expected.mean.rotation().matrix()).T
    ahead = z > 0
    x, y, near = x[ahead] / z[ahead], y[ahead] / z[ahead], 1 / z[ahead]
    zero = np.zeros_like(x)
    # A pose perturbed by (w, v) on the right sees the point at p + [p]x w - v.
    by_pose = camera.fx * np.stack(
        [
            np.stack([x * y, -(1 + x * x), y, -near, zero, near * x], axis=1),
            np.stack([1 + y * y, -x * y, -x, zero, -near, near * y], axis=1),
        ],
        axis=1,
    )
    innovation = camera.fx * (camera.normalize(pixels[ahead]) - np.column_stack([x, y]))
    spread = by_pose @ expected.covariance @ by_pose.mT + (WIDTH * sigma) ** 2 * np.eye(2)
    distances = np.full(len(points), np.inf)
    distances[ahead] = (innovation * np.linalg.solve(spread, innovation[:, :, None])[:, :, 0]).sum(axis=1)
    return distances
