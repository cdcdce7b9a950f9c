"""What odometry, landmarks and other knowledge say, as factors of GTSAM."""

from __future__ import annotations

import math
from collections.abc import Callable

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.camera import Camera
from fvslam_graph.config import GraphSettings
from fvslam_graph.estimates import GaussianPose, LogScale

Array = NDArray[np.float64]

LEAST_VARIANCE = 1e-12  # rad^2 and m^2: no factor is exact
SHORT = 1e-3  # metres; shorter motions have no direction that could be told
CARRIED_SIGMA = 0.3  # of the log length of a motion about whose scale no source has spoken: what keeps it determined

_KERNELS: dict[str, Callable[[float], gtsam.noiseModel.mEstimator.Base]] = {
    "huber": gtsam.noiseModel.mEstimator.Huber.Create,
    "cauchy": gtsam.noiseModel.mEstimator.Cauchy.Create,
    "geman_mcclure": gtsam.noiseModel.mEstimator.GemanMcClure.Create,
}


def pose_key(frame: int) -> int:
    """Of the camera's pose world_T_camera at a frame."""
    return int(gtsam.symbol("x", frame))


def is_pose(key: int) -> bool:
    """Whether a variable is a pose, and not a landmark."""
    return bool(gtsam.Symbol(key).chr() == ord("x"))


def landmark_key(landmark: int) -> int:
    """Of a landmark's position in the world."""
    return int(gtsam.symbol("l", landmark))


def robust(model: gtsam.noiseModel.Base, settings: GraphSettings) -> gtsam.noiseModel.Base:
    """The noise with the configured kernel, whose width is in standard deviations of a single number.

    A kernel sees the norm of all numbers of a measurement, which grows with the root of how many there are.
    """
    if settings.kernel == "none":
        return model
    width = settings.kernel_width * math.sqrt(model.dim())
    return gtsam.noiseModel.Robust.Create(_KERNELS[settings.kernel](width), model)


def odometry_factors(
    previous: int, index: int, prev_T_cur: GaussianPose, length: LogScale | None, settings: GraphSettings
) -> list[gtsam.NonlinearFactor]:
    """A motion of odometry between two frames.

    As `between`, it has six degrees of freedom, its scale with the uncertainty that odometry gives it. As `essential`,
    it has the five that two views measure, and the length is a factor of its own: what the scale source says of this
    baseline alone.

    Args:
        previous, index: The frames.
        prev_T_cur: The motion.
        length: What the scale source says; None where it does not speak.
        settings: Kind of factor, kernel, deflation.
    """
    keys = pose_key(previous), pose_key(index)
    factor = settings.deflation if settings.counting == "deflated" else 1.0
    covariance = factor * prev_T_cur.covariance + LEAST_VARIANCE * np.eye(6)
    distance = float(np.linalg.norm(prev_T_cur.mean.translation()))
    if settings.odometry == "between" or distance < SHORT:
        noise = robust(gtsam.noiseModel.Gaussian.Covariance(covariance), settings)
        return [gtsam.BetweenFactorPose3(*keys, prev_T_cur.mean, noise)]
    direction = gtsam.Unit3(prev_T_cur.mean.translation())
    by_pose = np.zeros((5, 6))
    by_pose[:3, :3] = np.eye(3)
    by_pose[3:, 3:] = direction.basis().T @ prev_T_cur.mean.rotation().matrix() / distance
    noise = robust(gtsam.noiseModel.Gaussian.Covariance(by_pose @ covariance @ by_pose.T), settings)
    essential = gtsam.EssentialMatrix(prev_T_cur.mean.rotation(), direction)
    metres, sigma = (distance, CARRIED_SIGMA) if length is None else (np.exp(length.mean), np.sqrt(length.variance))
    return [
        gtsam.EssentialMatrixConstraint(*keys, essential, noise),
        gtsam.RangeFactorPose3(*keys, metres, gtsam.noiseModel.Isotropic.Sigma(1, metres * sigma)),
    ]


class LandmarkFactors:
    """Makes factors of what is seen of a landmark.

    Args:
        camera: Undistorted.
        settings: Noise of a pixel, kernel.
    """

    def __init__(self, camera: Camera, settings: GraphSettings) -> None:
        self.calibration = gtsam.Cal3_S2(camera.fx, camera.fy, 0.0, camera.cx, camera.cy)
        self._settings = settings
        self._pixel = gtsam.noiseModel.Isotropic.Sigma(2, settings.pixel_sigma)
        self._noise = robust(self._pixel, settings)

    def projection(self, frame: int, landmark: int, pixel: Array) -> gtsam.NonlinearFactor:
        """A pixel (2,)."""
        keys = pose_key(frame), landmark_key(landmark)
        return gtsam.GenericProjectionFactorCal3_S2(pixel, self._noise, *keys, self.calibration, False, False)

    def bearing_range(self, frame: int, landmark: int, point: Array, covariance: Array) -> gtsam.NonlinearFactor:
        """A point (3,) in the camera with its covariance (3, 3), metres."""
        distance = float(np.linalg.norm(point))
        bearing = gtsam.Unit3(point)
        by_point = np.vstack([bearing.basis().T / distance, point[None] / distance])
        noise = gtsam.noiseModel.Gaussian.Covariance(by_point @ covariance @ by_point.T + LEAST_VARIANCE * np.eye(3))
        keys = pose_key(frame), landmark_key(landmark)
        return gtsam.BearingRangeFactor3D(*keys, bearing, distance, robust(noise, self._settings))

    def smart(self, views: list[tuple[int, Array]]) -> gtsam.NonlinearFactor:
        """All views (frame, pixel) of a landmark, which is eliminated in the factor itself."""
        parameters = gtsam.SmartProjectionParams()
        factor = gtsam.SmartProjectionPoseFactorCal3_S2(self._pixel, self.calibration, parameters)
        for frame, pixel in views:
            factor.add(pixel, pose_key(frame))
        return factor


def height_factor(frame: int, height: float, sigma: float, down: Array) -> gtsam.NonlinearFactor:
    """The camera's height (m) above that of the first frame, along `down`, (3,), a unit vector in the world."""
    axes = np.column_stack([*gtsam.Unit3(down).basis().T, down])
    covariance = axes @ np.diag([1e8, 1e8, sigma**2]) @ axes.T  # nothing is said of where it is above ground
    return gtsam.GPSFactor(pose_key(frame), -height * down, gtsam.noiseModel.Gaussian.Covariance(covariance))


def position_factor(frame: int, position: Array, sigma: float) -> gtsam.NonlinearFactor:
    """The camera's position (3,) in the world, metres, as satellites tell it."""
    return gtsam.GPSFactor(pose_key(frame), position, gtsam.noiseModel.Isotropic.Sigma(3, sigma))


def pose_factor(frame: int, pose: GaussianPose) -> gtsam.NonlinearFactor:
    """A known pose world_T_camera, such as that of the start."""
    noise = gtsam.noiseModel.Gaussian.Covariance(pose.covariance + LEAST_VARIANCE * np.eye(6))
    return gtsam.PriorFactorPose3(pose_key(frame), pose.mean, noise)
