"""Pose of a camera among points of known depth, for motions too short to triangulate."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import VoSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.inverse_depths import InverseDepths
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.features.ransac import absolute_pose
from fvslam_graph.vo.depth import scale_ratio
from fvslam_graph.vo.m_estimator import m_estimator_covariance, neighbourhoods
from fvslam_graph.vo.motion_fit import CONVERGED_STEP, KERNEL, RELAXED, WIDTHS
from fvslam_graph.vo.relative_pose import START_NOISE, RelativePose, a_sample, ransac_options
from fvslam_graph.vo.reprojection import ReprojectionErrors, reprojection_errors

NOISE = (0.1, 2.0)  # pixels, between which that of a track lies
MIN_SHARE = 0.7  # of the tracks of two views that agree with known depths as well, at least

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
    def J_direction(self) -> Array:
        """(5, 6) how rotation and direction of travel, as in RelativePose, change with the pose."""
        metres, rotation = self.pose.mean.translation(), self.pose.mean.rotation().matrix()
        jacobian = np.zeros((5, 6))
        jacobian[:3, :3] = np.eye(3)
        jacobian[3:, 3:] = gtsam.Unit3(metres).basis().T @ rotation / float(np.linalg.norm(metres))
        return jacobian

    @property
    def direction_covariance(self) -> Array:
        """(5, 5) of rotation and direction of travel, as in RelativePose."""
        covariance: Array = self.J_direction @ self.pose.covariance @ self.J_direction.T
        return covariance


def refine_absolute_pose(
    keyframe_T_cur: gtsam.Pose3, rays: Array, tracks: Tracks, depths: InverseDepths, camera: Camera
) -> AbsolutePose | None:
    """The pose near another by all tracks, each counting for what its depth tells, however little that is.

    Iteratively reweighted least squares (Cauchy) for the pose, and for what the depths err together, of which their
    common errors are a prior; the covariance is that of the M-estimator, from residuals that may be alike within a
    neighbourhood.

    Args:
        keyframe_T_cur: To begin with, metres.
        rays, tracks, depths, camera: As in `reprojection_errors`.

    Returns:
        None where they do not determine it.
    """
    noise, shared = START_NOISE, np.zeros(depths.common.shape[1])
    prior = np.diag(np.repeat([0.0, 1.0], (6, len(shared))))

    def errors_by(noise: float) -> tuple[ReprojectionErrors, Array]:
        """Errors with the depths as they are by now, and their Jacobian (N, 2, 6 + S) by pose and common errors."""
        known = replace(depths, values=depths.values + depths.common @ shared)
        errors = reprojection_errors(keyframe_T_cur, rays, tracks, known, camera, noise)
        return errors, np.concatenate([errors.J_pose, errors.J_common], axis=2)

    for width in WIDTHS:
        errors, jacobian = errors_by(width * noise)
        weight = errors.agree / (1 + errors.squares / KERNEL**2)
        jacobian = jacobian.reshape(-1, len(prior))
        weighted = np.repeat(weight, 2)[:, None] * jacobian
        information = weighted.T @ jacobian + prior
        if not np.linalg.cond(information) < 1e14:
            return None
        pull = weighted.T @ errors.values.ravel()
        pull[6:] += shared
        step = -np.linalg.solve(information, pull)
        deviations = math.sqrt(step @ information @ step)
        step *= RELAXED if width == 1 else 1.0
        keyframe_T_cur, shared = keyframe_T_cur.retract(step[:6]), shared + step[6:]
        noise = float(np.clip(width * noise * errors.deviation, *NOISE))
        if width == 1 and deviations < CONVERGED_STEP:
            break
    errors, jacobian = errors_by(noise)
    agree = errors.agree
    values, jacobian = errors.values[agree], jacobian[agree]
    covariance = m_estimator_covariance(values, jacobian, KERNEL, neighbourhoods(tracks.keyframe[agree], camera), prior)
    if covariance is None:
        return None
    weighted = jacobian / (1 + errors.squares[agree] / KERNEL**2)[:, None, None]
    information = np.einsum("nri,nrj->ij", weighted, jacobian) + prior
    pull = np.einsum("nri,nrj->ij", weighted, errors.J_calibration()[agree])
    J_calibration: Array = -np.linalg.solve(information, pull)[:6]
    return AbsolutePose(GaussianPose(keyframe_T_cur, covariance[:6, :6]), agree, noise, J_calibration)


def with_known_depths(
    relative_pose: RelativePose, tracks: Tracks, unit: InverseDepths, known: InverseDepths, camera: Camera
) -> RelativePose | None:
    """What two views and the depths that are known in the first one tell together; None where they do not agree.

    Args:
        relative_pose: By the two views alone.
        tracks: N that agree with it,
        unit: (N,) and their depths by it, in baselines.
        known: Depths in the first view.
        camera: Undistorted.
    """
    ratio = scale_ratio(unit, known)
    if ratio is None:
        return None
    start = gtsam.Pose3(relative_pose.rotation, ratio.scale.metres * relative_pose.direction)
    refined = refine_absolute_pose(start, camera.rays(tracks.keyframe), tracks, known.of(tracks.ids), camera)
    if refined is None or refined.agree.mean() < MIN_SHARE:
        return None
    metres = refined.pose.mean.translation()
    if not np.any(metres):
        return None
    return replace(
        relative_pose,
        rotation=refined.pose.mean.rotation(),
        direction=metres / np.linalg.norm(metres),
        covariance=refined.direction_covariance,
        J_calibration=refined.J_direction @ refined.J_calibration,
    )
