"""Pose of a camera among points of known depth, for motions too short to triangulate."""

from __future__ import annotations

import gtsam
import numpy as np
import poselib
from numpy.typing import NDArray

from fvslam_graph.camera import Camera
from fvslam_graph.config import VoSettings
from fvslam_graph.vo.two_view import LOSS_SCALE, m_estimator_covariance, poselib_camera


def locate(
    points: NDArray[np.float64],
    pixels: NDArray[np.float64],
    camera: Camera,
    settings: VoSettings,
    seed: int,
    shared: NDArray[np.float64] | None = None,
) -> tuple[gtsam.Pose3, NDArray[np.float64], NDArray[np.bool_]] | None:
    """Three-point RANSAC with local optimisation (PoseLib), refined on all inliers; None without a solution.

    Args:
        points: (N, 3) in the reference camera, metres.
        pixels: (N, 2) where the current camera sees them.
        camera: Undistorted.
        settings: Thresholds.
        seed: Of the RANSAC.
        shared: (N, 3, S) what each of S errors of deviation 1, which all points share, adds to them; none by itself.

    Returns:
        ref_T_cur, its covariance (6, 6) and (N,) bool which points agree.
    """
    if len(points) < settings.min_inliers:
        return None
    ransac = {
        "max_reproj_error": 2 * settings.ransac_threshold,
        "min_iterations": settings.ransac_iterations,
        "max_iterations": 20 * settings.ransac_iterations,
        "seed": seed,
    }
    bundle = {"loss_type": "CAUCHY", "loss_scale": LOSS_SCALE}
    pose, info = poselib.estimate_absolute_pose(pixels, points, poselib_camera(camera), ransac, bundle)
    inliers = np.array(info["inliers"], bool)
    if inliers.sum() < settings.min_inliers:
        return None
    residual, jacobian = reprojection(points[inliers] @ pose.R.T + pose.t, pixels[inliers], camera)
    by_shared = None
    if shared is not None:
        by_seen = -jacobian[:, 3:].reshape(-1, 2, 3)
        by_shared = (by_seen @ (pose.R @ shared[inliers])).reshape(len(residual), -1)
    covariance = m_estimator_covariance(residual, jacobian, LOSS_SCALE, by_shared)
    if covariance is None:
        return None
    return gtsam.Pose3(gtsam.Rot3(pose.R), pose.t).inverse(), covariance, inliers


def reprojection(
    seen: NDArray[np.float64], pixels: NDArray[np.float64], camera: Camera
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Reprojection errors and their Jacobian in the tangent of the camera's pose.

    Args:
        seen: (N, 3) points in the camera, metres.
        pixels: (N, 2) where they are observed.
        camera: Undistorted.

    Returns:
        (2N,) pixels, predicted minus observed, and (2N, 6).
    """
    x, y, z = seen.T
    zero = np.zeros_like(x)
    by_point = np.stack(
        [
            np.stack([camera.fx / z, zero, -camera.fx * x / z**2], axis=1),
            np.stack([zero, camera.fy / z, -camera.fy * y / z**2], axis=1),
        ],
        axis=1,
    )
    # A pose perturbed by (w, v) on the right sees the point at p + [p]x w - v.
    cross = np.stack(
        [np.stack([zero, -z, y], axis=1), np.stack([z, zero, -x], axis=1), np.stack([-y, x, zero], axis=1)], axis=1
    )
    by_pose = np.concatenate([cross, np.broadcast_to(-np.eye(3), cross.shape)], axis=2)
    jacobian = (by_point @ by_pose).reshape(-1, 6)
    return (camera.project(seen) - pixels).ravel(), jacobian
