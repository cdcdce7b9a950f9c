"""The camera's calibration as a variable of the graph: focal length and radial distortion, of all images the same."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Distortion
from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.frame_result import CalibrationEstimate
from fvslam_graph.core.vo_estimate import CalibrationEvidence

Array = NDArray[np.float64]

CALIBRATION = int(gtsam.symbol("c", 0))
TAILS = 1.0  # standard deviations, width of a Cauchy distribution
MAX_K1 = 1.0
EXACT_SIGMA = 1e-6  # standard deviation of what is not estimated, as no factor is exact,
ANY_SIGMA = 1e6  # and of what may be anything


class SelfCalibration:
    """Turns the calibration of the file into a variable with a prior, and its estimate into a camera.

    The variable is GTSAM's Cal3Bundler, whose pixels are square: those of the camera are stretched to be so.

    Args:
        camera: As the file has it, undistorted.
        settings: How well its numbers are known.
    """

    def __init__(self, camera: Camera, settings: GraphSettings) -> None:
        self._camera = camera
        self._sigmas = np.maximum([settings.focal_sigma * camera.fx, settings.distortion_sigma, 0.0], EXACT_SIGMA)
        self.start = gtsam.Cal3Bundler(camera.fx, 0.0, 0.0, camera.cx, camera.cy)

    def priors(self) -> list[gtsam.NonlinearFactor]:
        """The file is right as a rule, and if it is not, may be wrong by far: in the one number or in the other."""
        factors = []
        for number in range(2):
            sigmas = np.where(np.arange(3) == number, self._sigmas, ANY_SIGMA)
            tails = gtsam.noiseModel.mEstimator.Cauchy.Create(TAILS)
            noise = gtsam.noiseModel.Robust.Create(tails, gtsam.noiseModel.Diagonal.Sigmas(sigmas))
            factors.append(gtsam.PriorFactorCal3Bundler(CALIBRATION, self.start, noise))
        held = gtsam.noiseModel.Diagonal.Sigmas([ANY_SIGMA, ANY_SIGMA, EXACT_SIGMA])
        return [*factors, gtsam.PriorFactorCal3Bundler(CALIBRATION, self.start, held)]

    def measured(self, evidence: CalibrationEvidence) -> gtsam.NonlinearFactor:
        """A linear factor of what images say, about the file's calibration."""
        root = np.linalg.cholesky(evidence.information + EXACT_SIGMA * np.eye(2)).T
        values = gtsam.Values()
        values.insert(CALIBRATION, self.start)
        right = np.linalg.solve(root.T, evidence.gradient)
        linear = gtsam.JacobianFactor(CALIBRATION, root @ self.jacobian(), right, gtsam.noiseModel.Unit.Create(2))
        return gtsam.LinearContainerFactor(linear, values)

    def step(self, value: gtsam.Cal3Bundler) -> Array:
        """The change that a value makes to the logarithm of the focal length and to k1 of the file, (2,)."""
        return np.array([value.fx() / self._camera.fx - 1, value.k1()])

    def jacobian(self) -> Array:
        """Derivative of this step in the tangent of the variable, (2, 3)."""
        return np.array([[1 / self._camera.fx, 0.0, 0.0], [0.0, 1.0, 0.0]])

    def stretched(self, pixel: Array) -> Array:
        """A pixel (2,) where it would be if pixels were square."""
        camera = self._camera
        return np.array([pixel[0], camera.cy + (pixel[1] - camera.cy) * camera.fx / camera.fy])

    def camera(self, value: gtsam.Cal3Bundler) -> Camera:
        """The camera with another value of the variable."""
        return replace(
            self._camera,
            fx=value.fx(),
            fy=value.fx() * self._camera.fy / self._camera.fx,
            distortion=Distortion.RADTAN,
            coefficients=(value.k1(), value.k2(), 0.0, 0.0),
        )


def is_camera(value: gtsam.Cal3Bundler) -> bool:
    """Whether a camera can be like that: a step that is too long may lead anywhere."""
    return bool(value.fx() > 0 and abs(value.k1()) < MAX_K1)


def calibration_estimate(value: gtsam.Cal3Bundler, covariance: Array) -> CalibrationEstimate:
    """A value of the variable with its covariance (3, 3)."""
    focal_sigma, k1_sigma, _ = np.sqrt(np.diag(covariance))
    return CalibrationEstimate(value.fx(), float(focal_sigma), value.k1(), float(k1_sigma))
