"""Factors of GTSAM for odometry, landmarks and other knowledge."""

from __future__ import annotations

import math
from collections.abc import Callable

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.sensors import GRAVITY_SIGMA
from fvslam_graph.core.vo_estimate import OdometryStep
from fvslam_graph.graph.calibration import CALIBRATION, SelfCalibration

Array = NDArray[np.float64]

MIN_VARIANCE = 1e-10  # rad^2 and m^2: no factor is exact, and what is known of a whole path is of the order of 1
# Of the covariance of a motion that is told in two steps, the second one's share. It is linear in poses, and what that
# errs by where the path moves far from where it began must be small against it.
LINEAR_SHARE = 0.5
ENU = int(gtsam.symbol("e", 0))  # the key of world_T_enu, where east, north, up at a place on Earth is in the world
CLOCK = int(gtsam.symbol("t", 0))  # the key of what is added to the stamps of fixes to have those of images, seconds
HEIGHT = int(gtsam.symbol("h", 0))  # the key of the logarithm of true over given height above the ground
LASTING = (CALIBRATION, ENU, CLOCK, HEIGHT)  # what is of the whole run
SHORT = 1e-3  # metres; shorter motions have no direction that could be told, nor a length along it

_KERNELS: dict[str, Callable[[float], gtsam.noiseModel.mEstimator.Base]] = {
    "huber": gtsam.noiseModel.mEstimator.Huber.Create,
    "cauchy": gtsam.noiseModel.mEstimator.Cauchy.Create,
    "geman_mcclure": gtsam.noiseModel.mEstimator.GemanMcClure.Create,
}


def pose_key(frame: int) -> int:
    """The key of the camera's pose world_T_camera at a frame."""
    return int(gtsam.symbol("x", frame))


def filed_key(frame: int) -> int:
    """The key of where the motion to a frame would have led by the calibration of the file."""
    return int(gtsam.symbol("y", frame))


def fix_key(number: int) -> int:
    """The key of the camera's pose world_T_camera at the time of a fix."""
    return int(gtsam.symbol("g", number))


def is_at_fix(key: int) -> bool:
    """Whether a variable is such a pose."""
    return bool(gtsam.Symbol(key).chr() == ord("g"))


def is_filed(key: int) -> bool:
    """Whether a variable is such a pose."""
    return bool(gtsam.Symbol(key).chr() == ord("y"))


def is_pose(key: int) -> bool:
    """Whether a variable is a pose."""
    return bool(gtsam.Symbol(key).chr() == ord("x"))


def is_landmark(key: int) -> bool:
    """Whether a variable is a landmark."""
    return bool(gtsam.Symbol(key).chr() == ord("l"))


def is_scale(key: int) -> bool:
    """Whether a variable is the logarithm of a scale, or what its source errs by, see `scale_chain`."""
    return chr(gtsam.Symbol(key).chr()) in "sb"


def landmark_key(landmark: int) -> int:
    """The key of a landmark's position in the world."""
    return int(gtsam.symbol("l", landmark))


def robust(model: gtsam.noiseModel.Base, settings: GraphSettings, share: float = 1.0) -> gtsam.noiseModel.Base:
    """The noise with the configured kernel, whose width is in standard deviations of a single number.

    A kernel sees the norm of all numbers of a measurement, which grows with the root of how many there are.

    Args:
        model: The noise.
        settings: Which kernel, how wide.
        share: Of the deviation, by which outliers are told from the rest.
    """
    if settings.kernel == "none":
        return model
    width = share * settings.kernel_width * math.sqrt(model.dim())
    return gtsam.noiseModel.Robust.Create(_KERNELS[settings.kernel](width), model)


def motion_factor(
    previous: int, index: int, prev_T_cur: GaussianPose, settings: GraphSettings, length: bool = True
) -> gtsam.NonlinearFactor:
    """A motion of odometry between two frames.

    As `between`, it has six degrees of freedom, or five where the length is told by another factor. As `essential`, it
    has the five that two views measure.

    Args:
        previous, index: The frames.
        prev_T_cur: The motion.
        settings: Kind of factor, kernel, deflation.
        length: Whether it tells how long the motion is; an `essential` one never does.
    """
    keys = pose_key(previous), pose_key(index)
    distance = float(np.linalg.norm(prev_T_cur.mean.translation()))
    if settings.odometry == "between" or distance < SHORT:
        return gtsam.BetweenFactorPose3(*keys, prev_T_cur.mean, motion_noise(prev_T_cur, settings, length))
    direction = gtsam.Unit3(prev_T_cur.mean.translation())
    J_pose = np.zeros((5, 6))
    J_pose[:3, :3] = np.eye(3)
    J_pose[3:, 3:] = direction.basis().T @ prev_T_cur.mean.rotation().matrix() / distance
    covariance = J_pose @ _counted(prev_T_cur, settings) @ J_pose.T
    noise = robust(gtsam.noiseModel.Gaussian.Covariance(covariance), settings)
    essential = gtsam.EssentialMatrix(prev_T_cur.mean.rotation(), direction)
    return gtsam.EssentialMatrixConstraint(*keys, essential, noise)


def motion_noise(prev_T_cur: GaussianPose, settings: GraphSettings, length: bool) -> gtsam.noiseModel.Base:
    """The noise of a motion of six degrees of freedom, or five where another factor tells the length."""
    covariance = _counted(prev_T_cur, settings)
    told = gtsam.noiseModel.Gaussian.Covariance(covariance)
    if not length:
        travel = gtsam.Unit3(prev_T_cur.mean.rotation().unrotate(prev_T_cur.mean.translation()))
        across = np.zeros((6, 5))
        across[:3, :3], across[3:, 3:] = np.eye(3), travel.basis()
        root = np.zeros((6, 6))
        root[:5] = np.linalg.inv(np.linalg.cholesky(across.T @ covariance @ across)) @ across.T
        told = gtsam.noiseModel.Gaussian.SqrtInformation(root, False)
    return robust(told, settings)


def _counted(motion: GaussianPose, settings: GraphSettings) -> Array:
    """Its covariance (6, 6), where pixels of landmarks are not to count twice."""
    factor = settings.deflation if settings.shared_pixels == "deflate" else 1.0
    counted: Array = factor * motion.covariance + MIN_VARIANCE * np.eye(6)
    return counted


def length_factor(previous: int, index: int, metres: float, sigma: float) -> gtsam.NonlinearFactor:
    """How far apart the camera was at two frames, with its standard deviation, metres."""
    noise = gtsam.noiseModel.Isotropic.Sigma(1, sigma)
    return gtsam.RangeFactorPose3(pose_key(previous), pose_key(index), metres, noise)


def calibrated_motion_factors(
    index: int,
    step: OdometryStep,
    settings: GraphSettings,
    calibration: SelfCalibration,
    start: gtsam.Pose3,
    length: bool = True,
) -> list[gtsam.NonlinearFactor]:
    """A motion as `between` of `motion_factor`, with a mean that changes with the calibration as odometry says.

    With a factor of our own in Python, GTSAM would copy all variables each time that it is linearised. So a motion
    leads to where the camera would be by the calibration of the file (`filed_key`), and from there it is a linear step.

    Args:
        index: The frame.
        step: The motion that leads there.
        settings: Kernel, deflation.
        calibration: The variable.
        start: Where both poses are linearised first.
        length: Whether it tells how long the motion is.
    """
    filed, measured = filed_key(index), step.prev_T_cur.mean
    covariance = step.prev_T_cur.covariance
    noise = motion_noise(GaussianPose(measured, (1 - LINEAR_SHARE) * covariance), settings, length)
    values = gtsam.Values()
    values.insert(filed, start)
    values.insert(pose_key(index), start)
    values.insert(CALIBRATION, calibration.start)
    J_calibration = step.J_calibration @ calibration.jacobian()
    root = np.linalg.inv(np.linalg.cholesky(_counted(GaussianPose(measured, LINEAR_SHARE * covariance), settings)))
    unit = gtsam.noiseModel.Unit.Create(6)
    known = root @ step.J_calibration @ step.calibration  # is in the motion already
    linear = gtsam.JacobianFactor(filed, root, pose_key(index), -root, CALIBRATION, root @ J_calibration, known, unit)
    return [
        gtsam.BetweenFactorPose3(pose_key(step.previous), filed, measured, noise),
        gtsam.LinearContainerFactor(linear, values),
    ]


class LandmarkFactors:
    """Makes factors of what is seen of a landmark.

    Args:
        camera: Undistorted.
        settings: Noise of a pixel, kernel.
    """

    def __init__(self, camera: Camera, settings: GraphSettings) -> None:
        self.calibration = SelfCalibration(camera, settings)
        self._fixed = gtsam.Cal3_S2(camera.fx, camera.fy, 0.0, camera.cx, camera.cy)
        self._settings = settings

    def deviation(self, sigma: float, count: int) -> float:
        """The deviation of a pixel with noise `sigma` of its own along each axis, in an image with so many landmarks.

        Their common error, by what makes tracks drift, does not average out. A covariance
        s^2 v v^T, whatever the pattern v of numbers up to 1, is at most N s^2 I, for N landmarks: with that added to
        the variance of each one, they may be taken as independent.
        """
        return sigma * math.sqrt(1 + count * self._settings.common_noise**2)

    def projection(self, frame: int, landmark: int, pixel: Array, sigma: float, count: int) -> gtsam.NonlinearFactor:
        """A pixel (2,) by the camera's estimated calibration, see `deviation`.

        Outliers are told by what it errs on its own.
        """
        deviation = self.deviation(sigma, count)
        noise = robust(gtsam.noiseModel.Isotropic.Sigma(2, deviation), self._settings, sigma / deviation)
        keys = pose_key(frame), landmark_key(landmark), CALIBRATION
        return gtsam.GeneralSFMFactor2Cal3Bundler(self.calibration.stretched(pixel), noise, *keys)

    def bearing_range(self, frame: int, landmark: int, point: Array, covariance: Array) -> gtsam.NonlinearFactor:
        """A point (3,) in the camera with its covariance (3, 3), metres."""
        distance = float(np.linalg.norm(point))
        bearing = gtsam.Unit3(point)
        J_point = np.vstack([bearing.basis().T / distance, point[None] / distance])
        noise = gtsam.noiseModel.Gaussian.Covariance(J_point @ covariance @ J_point.T + MIN_VARIANCE * np.eye(3))
        keys = pose_key(frame), landmark_key(landmark)
        return gtsam.BearingRangeFactor3D(*keys, bearing, distance, robust(noise, self._settings))

    def smart(self, views: list[tuple[int, Array]], sigma: float, count: int) -> gtsam.NonlinearFactor:
        """All views (frame, pixel) of a landmark, which is eliminated in the factor itself; see `deviation`."""
        parameters = gtsam.SmartProjectionParams()
        parameters.setLinearizationMode(gtsam.LinearizationMode.JACOBIAN_SVD)  # which can be factorised by QR, too
        noise = gtsam.noiseModel.Isotropic.Sigma(2, self.deviation(sigma, count))
        factor = gtsam.SmartProjectionPoseFactorCal3_S2(noise, self._fixed, parameters)
        for frame, pixel in views:
            factor.add(pixel, pose_key(frame))
        return factor


def height_factor(frame: int, height: float, sigma: float, down: Array) -> gtsam.NonlinearFactor:
    """The camera's height (m) above that of the first frame, along `down`, (3,), a unit vector in the world."""
    axes = np.column_stack([*gtsam.Unit3(down).basis().T, down])
    covariance = axes @ np.diag([1e8, 1e8, sigma**2]) @ axes.T  # nothing is said of where it is above ground
    return gtsam.GPSFactor(pose_key(frame), -height * down, gtsam.noiseModel.Gaussian.Covariance(covariance))


def gravity_factor(frame: int, world_down: Array, down: Array) -> gtsam.NonlinearFactor:
    """The direction of gravity (3,) in the camera at a frame, which is `world_down` in the world."""
    noise = gtsam.noiseModel.Isotropic.Sigma(2, math.sqrt(2) * GRAVITY_SIGMA)  # both were measured
    return gtsam.AttitudeFactorPose3(pose_key(frame), gtsam.Unit3(world_down), noise, gtsam.Unit3(down))


def position_factor(frame: int, position: Array, sigma: float) -> gtsam.NonlinearFactor:
    """The camera's position (3,) in the world, metres, as satellites tell it."""
    return gtsam.GPSFactor(pose_key(frame), position, gtsam.noiseModel.Isotropic.Sigma(3, sigma))


def pose_factor(frame: int, pose: GaussianPose) -> gtsam.NonlinearFactor:
    """A known pose world_T_camera, such as that of the start."""
    noise = gtsam.noiseModel.Gaussian.Covariance(pose.covariance + MIN_VARIANCE * np.eye(6))
    return gtsam.PriorFactorPose3(pose_key(frame), pose.mean, noise)
