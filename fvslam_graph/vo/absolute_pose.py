"""Pose of a camera among points of known depth, for motions too short to triangulate."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import VoSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.inverse_depths import InverseDepths
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.features.ransac import absolute_pose
from fvslam_graph.vo.m_estimator import m_estimator_covariance, neighbourhoods
from fvslam_graph.vo.relative_pose import (
    CONVERGED_STEP,
    KERNEL,
    RELAXED,
    START_NOISE,
    WIDTHS,
    a_sample,
    ransac_options,
)
from fvslam_graph.vo.reprojection import reprojection_errors

NOISE = (0.1, 2.0)  # pixels, between which that of a track lies

Array = NDArray[np.float64]


def estimate_absolute_pose(
    points: Array, pixels: Array, camera: Camera, settings: VoSettings, seed: int
) -> gtsam.Pose3 | None:
    """keyframe_T_cur by three-point RANSAC; None without a solution.

    Args:
        points: (N, 3) in the keyframe, metres.
        pixels: (N, 2) where the current camera sees them.
        camera: Undistorted.
        settings: Thresholds.
        seed: Of the RANSAC.
    """
    if len(points) < settings.min_inliers:
        return None
    some = a_sample(len(points))
    options = ransac_options(2 * settings.ransac_threshold, settings, seed)
    found = absolute_pose(points[some], pixels[some], camera, options)
    if found is None:
        return None
    keyframe_T_cur, inliers = found
    return keyframe_T_cur if inliers.sum() * len(points) >= settings.min_inliers * len(some) else None


@dataclass(frozen=True)
class AbsolutePose:
    """A camera among points of known depth.

    Attributes:
        pose: keyframe_T_cur and its covariance.
        agree: (N,) which tracks agree.
        noise: Pixels, standard deviation of a corner's displacement along each axis, by these.
        J_calibration: (6, 2) how the pose changes with the logarithm of the focal length and with k1.
    """

    pose: GaussianPose
    agree: NDArray[np.bool_]
    noise: float
    J_calibration: Array

    @property
    def direction_covariance(self) -> Array:
        """(5, 5) of rotation and direction of travel, as in RelativePose."""
        metres, rotation = self.pose.mean.translation(), self.pose.mean.rotation().matrix()
        length = float(np.linalg.norm(metres))
        jacobian = np.zeros((5, 6))
        jacobian[:3, :3] = np.eye(3)
        jacobian[3:, 3:] = gtsam.Unit3(metres).basis().T @ rotation / length
        covariance: Array = jacobian @ self.pose.covariance @ jacobian.T
        return covariance


def refine_absolute_pose(
    keyframe_T_cur: gtsam.Pose3, rays: Array, tracks: Tracks, depths: InverseDepths, camera: Camera
) -> AbsolutePose | None:
    """The pose near another by all tracks, each counting for what its depth tells, however little that is.

    Iteratively reweighted least squares (Cauchy); the covariance is that of the M-estimator, from residuals that may
    be alike within a neighbourhood, and from what depths err together.

    Args:
        keyframe_T_cur: To begin with, metres.
        rays, tracks, depths, camera: As in `reprojection_errors`.

    Returns:
        None where they do not determine it.
    """
    noise = START_NOISE
    for width in WIDTHS:
        errors = reprojection_errors(keyframe_T_cur, rays, tracks, depths, camera, width * noise)
        weight = errors.agree / (1 + errors.squares / KERNEL**2)
        jacobian = errors.J_pose.reshape(-1, 6)
        weighted = np.repeat(weight, 2)[:, None] * jacobian
        information = weighted.T @ jacobian
        if not np.linalg.cond(information) < 1e14:
            return None
        step = -np.linalg.solve(information, weighted.T @ errors.values.ravel())
        keyframe_T_cur = keyframe_T_cur.retract(RELAXED * step if width == 1 else step)
        noise = float(np.clip(width * noise * errors.deviation, *NOISE))
        if width == 1 and step @ information @ step < CONVERGED_STEP**2:
            break
    errors = reprojection_errors(keyframe_T_cur, rays, tracks, depths, camera, noise)
    agree = errors.agree
    covariance = m_estimator_covariance(
        errors.values[agree],
        errors.J_pose[agree],
        KERNEL,
        neighbourhoods(tracks.keyframe[agree], camera),
        errors.J_common[agree],
    )
    if covariance is None:
        return None
    jacobian = errors.J_pose[agree].reshape(-1, 6)
    weighted = jacobian / np.repeat(1 + errors.squares[agree] / KERNEL**2, 2)[:, None]
    pull = weighted.T @ errors.J_calibration()[agree].reshape(-1, 2)
    J_calibration: Array = -np.linalg.inv(weighted.T @ jacobian) @ pull
    return AbsolutePose(GaussianPose(keyframe_T_cur, covariance), agree, noise, J_calibration)
