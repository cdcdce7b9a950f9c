"""Relative pose of two views from matched points: rotation and direction of travel, with their covariance."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
import poselib
from numpy.typing import NDArray

from fvslam_graph.camera import Camera
from fvslam_graph.config import VoSettings
from fvslam_graph.features.tracks import Tracks

SURPRISE = 0.01  # rad between expected and found rotation
ALIKE = 1.1  # costs within this factor do not tell two solutions apart
LOSS_SCALE = 0.3  # pixels; residuals well above the tracking noise lose weight (Cauchy)
# Deviation of a displacement by the median Sampson distance: of noise in one image, a distance over both has sqrt(1/2).
BY_MEDIAN = 2**0.5 / 0.6745

Rays = NDArray[np.float64]


@dataclass(frozen=True)
class TwoView:
    """What two views truly measure: five degrees of freedom.

    Attributes:
        rotation: prev_R_cur.
        direction: (3,) unit vector in the previous camera, from there to the current one.
        covariance: (5, 5) in the tangent of gtsam.EssentialMatrix(rotation, Unit3(direction)): rotation, then
            direction in the plane of gtsam.Unit3.basis; radians.
        inliers: (N,) bool, which of the tracks agree.
        noise: Pixels, standard deviation of a track's displacement along each axis, by these.
    """

    rotation: gtsam.Rot3
    direction: NDArray[np.float64]
    covariance: NDArray[np.float64]
    inliers: NDArray[np.bool_]
    noise: float


def rays(camera: Camera, pixels: NDArray[np.float64]) -> Rays:
    """Viewing rays (N, 3) of pixels (N, 2), with z = 1."""
    normalized = camera.normalize(pixels)
    return np.column_stack([normalized, np.ones(len(normalized))])


def estimate_two_view(
    tracks: Tracks, camera: Camera, settings: VoSettings, seed: int, expected: gtsam.Pose3 | None = None
) -> TwoView | None:
    """Five-point RANSAC with local optimisation (PoseLib), refined on all inliers; None without a solution.

    Points on a plane have two solutions that explain them alike. So the expected motion prev_T_cur is refined as well,
    and taken where it explains the inliers as well as the best one.

    Source: Nister 2004 (five points); Larsson et al., PoseLib (LO-RANSAC); covariance of an M-estimator after Huber,
    Robust Statistics, section 6.3.
    """
    if len(tracks) < settings.min_inliers:
        return None
    model = poselib_camera(camera)
    ransac = {
        "max_epipolar_error": settings.ransac_threshold,
        "min_iterations": settings.ransac_iterations,
        "max_iterations": 20 * settings.ransac_iterations,
        "seed": seed,
    }
    bundle = {"loss_type": "CAUCHY", "loss_scale": LOSS_SCALE}
    pose, info = poselib.estimate_relative_pose(tracks.reference, tracks.current, model, model, ransac, bundle)
    inliers = np.array(info["inliers"], bool)
    if inliers.sum() < max(settings.min_inliers, settings.min_inlier_share * len(tracks)):
        return None
    agreeing = tracks[inliers]
    previous, current = rays(camera, agreeing.reference), rays(camera, agreeing.current)
    solution = _fit(pose, previous, current, camera)
    if expected is not None and _disagree(solution, expected):
        start = poselib.CameraPose()
        start.R, start.t = expected.rotation().matrix().T, expected.inverse().translation()
        pose, _ = poselib.refine_relative_pose(agreeing.reference, agreeing.current, start, model, model, bundle)
        alternative = _fit(pose, previous, current, camera)
        if alternative.cost < ALIKE * solution.cost:
            solution = alternative
    covariance = m_estimator_covariance(solution.distance, solution.jacobian, LOSS_SCALE)
    if covariance is None:
        return None
    noise = BY_MEDIAN * float(np.median(np.abs(solution.distance)))
    return TwoView(solution.rotation, solution.direction, covariance, inliers, noise)


def _disagree(solution: _Fit, expected: gtsam.Pose3) -> bool:
    """Whether the solution turned otherwise than expected, as the second solution of a plane does."""
    moving = np.linalg.norm(expected.translation()) > 0
    turned = gtsam.Rot3.Logmap(expected.rotation().between(solution.rotation))
    return bool(moving and np.linalg.norm(turned) > SURPRISE)


@dataclass(frozen=True)
class _Fit:
    """A relative pose and how well it explains the inliers: Sampson distances, their Jacobian and Cauchy cost."""

    rotation: gtsam.Rot3
    direction: NDArray[np.float64]
    distance: NDArray[np.float64]
    jacobian: NDArray[np.float64]
    cost: float


def _fit(pose: poselib.CameraPose, previous: Rays, current: Rays, camera: Camera) -> _Fit:
    rotation, direction = gtsam.Rot3(pose.R.T), -pose.R.T @ pose.t
    direction /= np.linalg.norm(direction)
    distance, jacobian = sampson(previous, current, rotation, direction, camera.fx)
    return _Fit(rotation, direction, distance, jacobian, float(np.log1p((distance / LOSS_SCALE) ** 2).sum()))


def poselib_camera(camera: Camera) -> dict[str, object]:
    """The undistorted camera as PoseLib takes it."""
    parameters = [camera.fx, camera.fy, camera.cx, camera.cy]
    return {"model": "PINHOLE", "width": camera.width, "height": camera.height, "params": parameters}


def sampson(
    previous: Rays, current: Rays, rotation: gtsam.Rot3, direction: NDArray[np.float64], focal: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sampson distances (N,), pixels, and their Jacobian (N, 5) in the tangent of TwoView.

    The weight of the distance is held fixed in the Jacobian, as in Gauss-Newton: exact where the distance is zero.
    Source: Hartley and Zisserman, Multiple View Geometry, eq. 11.9.
    """
    rotated = current @ rotation.matrix().T
    essential = gtsam.SO3.Hat(direction) @ rotation.matrix()
    line_previous = current @ essential.T  # E x_cur
    line_current = previous @ essential  # E^T x_prev
    steepness = (line_previous[:, :2] ** 2).sum(axis=1) + (line_current[:, :2] ** 2).sum(axis=1)
    weight = focal / np.sqrt(np.maximum(steepness, 1e-12))  # both points on an epipole have no epipolar line
    distance = weight * (previous * line_previous).sum(axis=1)
    by_rotation = np.cross(current, line_current)
    by_direction = np.cross(rotated, previous) @ gtsam.Unit3(direction).basis()
    return distance, weight[:, None] * np.hstack([by_rotation, by_direction])


def m_estimator_covariance(
    residual: NDArray[np.float64],
    jacobian: NDArray[np.float64],
    loss_scale: float,
    shared: NDArray[np.float64] | None = None,
) -> NDArray[np.float64] | None:
    """Covariance of a Cauchy M-estimate from the residuals themselves, so that no noise level is assumed.

    Args:
        residual: (N,) at the estimate.
        jacobian: (N, P) of the residuals.
        loss_scale: Of the Cauchy loss, in the residuals' unit.
        shared: (N, S) what each of S errors of deviation 1 adds to all residuals together.

    Returns:
        (P, P); None where the residuals do not determine the parameters.
    """
    count, parameters = jacobian.shape
    square = (residual / loss_scale) ** 2
    influence = residual / (1 + square)
    curvature = (1 - square) / (1 + square) ** 2
    bread = jacobian.T @ (curvature[:, None] * jacobian)
    values = np.linalg.eigvalsh(bread)
    if count <= parameters or not values[0] > 1e-12 * values[-1]:
        return None
    inverse = np.linalg.inv(bread)
    meat = jacobian.T @ (influence[:, None] ** 2 * jacobian) * (count / (count - parameters))
    if shared is not None:
        pull = jacobian.T @ (curvature[:, None] * shared)
        meat += pull @ pull.T
    covariance: NDArray[np.float64] = inverse @ meat @ inverse
    return (covariance + covariance.T) / 2
