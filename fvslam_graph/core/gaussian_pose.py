"""Poses with their covariances: what the blocks hand to each other."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import gtsam
import numpy as np
from numpy.typing import NDArray

LOST_PROBABILITY = 0.25  # share of cases in which a camera that has lost the scene went anywhere meanwhile,
LOST_ROTATION = 1.0  # by so many rad (deviation), and as far as the scene was away
UNINFORMATIVE_VARIANCE = 0.2**2  # variance of the logarithm of a scale from which on it tells nothing


@dataclass(frozen=True)
class GaussianPose:
    """A pose a_T_b as a normal distribution.

    Attributes:
        mean: Metres.
        covariance: (6, 6) in the tangent of the mean: rotation (rad), then translation (m).
    """

    mean: gtsam.Pose3
    covariance: NDArray[np.float64]

    @classmethod
    def identity(cls) -> Self:
        """The exact identity."""
        return cls(gtsam.Pose3(), np.zeros((6, 6)))

    @classmethod
    def without_covariance(cls, mean: gtsam.Pose3) -> Self:
        """A pose of which nobody says how certain it is: its covariance is NaN."""
        return cls(mean, np.full((6, 6), np.nan))

    def compose(self, step: GaussianPose) -> GaussianPose:
        """a_T_c of this a_T_b and an independent b_T_c; to first order."""
        adjoint = step.mean.inverse().AdjointMap()
        covariance = adjoint @ self.covariance @ adjoint.T + step.covariance
        return GaussianPose(self.mean.compose(step.mean), (covariance + covariance.T) / 2)

    @property
    def travel(self) -> NDArray[np.float64]:
        """(6,) how it changes with the logarithm of its length, in its own tangent."""
        return np.concatenate([np.zeros(3), self.mean.rotation().unrotate(self.mean.translation())])

    def with_scale_variance(self, variance: float) -> GaussianPose:
        """The same with so much more variance of the logarithm of its length; less, where it is negative."""
        return GaussianPose(self.mean, self.covariance + variance * np.outer(self.travel, self.travel))

    def longer(self, factor: float) -> GaussianPose:
        """The same with all lengths so many times as long."""
        stretch = np.repeat([1.0, factor], 3)
        mean = gtsam.Pose3(self.mean.rotation(), factor * self.mean.translation())
        return GaussianPose(mean, self.covariance * np.outer(stretch, stretch))

    def room_for_scale(self, variance: float) -> float:
        """Variance of the logarithm of its length, at most what its covariance holds; of no length, any."""
        return _room(variance, self.travel, self.covariance) if self.travel.any() else variance

    def after_loss(self, distance: float) -> GaussianPose:
        """The same where nothing of the scene, `distance` metres away, was found again; the mean is a motion model's.

        Nobody knows how far the camera was carried: mostly it is where it was expected. But that nothing of the scene
        is in view suggests that it may have gone as far as the scene was away, or have turned from it. This is the
        covariance of a mixture of both.
        """
        sigmas = np.repeat([LOST_ROTATION, distance], 3)
        return GaussianPose(self.mean, self.covariance + LOST_PROBABILITY * np.diag(sigmas**2))

    def inverse(self) -> GaussianPose:
        """b_T_a."""
        adjoint = self.mean.AdjointMap()
        covariance = adjoint @ self.covariance @ adjoint.T
        return GaussianPose(self.mean.inverse(), (covariance + covariance.T) / 2)


@dataclass(frozen=True)
class ScaledPose:
    """A pose at the end of a path whose lengths have a scale that errs likewise from one motion to the next.

    Attributes:
        pose: a_T_b, as if the motions were independent.
        common: (6, 6) what its covariance is more, or less, as they are not.
        scale_covariance: (6,) covariance of its error and that of the logarithm of the last motion's scale,
        variance: and the variance of this.
    """

    pose: GaussianPose
    common: NDArray[np.float64]
    scale_covariance: NDArray[np.float64]
    variance: float

    @classmethod
    def of(cls, pose: GaussianPose, variance: float = 0.0) -> Self:
        """One motion, whose covariance contains so much variance of the logarithm of its length."""
        return cls(pose, np.zeros((6, 6)), variance * pose.travel, variance)

    @property
    def total(self) -> GaussianPose:
        """a_T_b with all its uncertainty."""
        return GaussianPose(self.pose.mean, self.pose.covariance + self.common)

    def replaced(self, pose: GaussianPose) -> ScaledPose:
        """Another estimate of the same motion, with as much of the scale's error as its covariance has room for."""
        if not self.variance > 0:
            return ScaledPose.of(pose)
        direction = self.scale_covariance / self.variance
        variance = _room(self.variance, direction, pose.covariance)
        return ScaledPose(pose, np.zeros((6, 6)), variance * direction, variance)

    def compose(self, step: ScaledPose) -> ScaledPose:
        """a_T_c of this a_T_b and b_T_c, which is independent of it but for the scale.

        A scale that is carried from motion to motion, and measured again now and then, is a Markov chain: what two of
        its errors have in common is the variance of the one that is known better.
        """
        adjoint = step.pose.mean.inverse().AdjointMap()
        transported = (
            adjoint @ self.scale_covariance * (min(1.0, step.variance / self.variance) if self.variance > 0 else 0.0)
        )
        both = np.outer(transported, step.scale_covariance / step.variance) if step.variance > 0 else np.zeros((6, 6))
        common = adjoint @ self.common @ adjoint.T + step.common + both + both.T
        return ScaledPose(self.pose.compose(step.pose), common, transported + step.scale_covariance, step.variance)


@dataclass(frozen=True)
class LogScale:
    """The natural logarithm of a scale, as a normal distribution.

    Attributes:
        mean: log(metres per unit baseline).
        variance: Its variance; 1 stands for "within a factor of about e".
    """

    mean: float
    variance: float

    @property
    def metres(self) -> float:
        """Length of the baseline."""
        return math.exp(self.mean)


def _room(variance: float, direction: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """Variance of an error along `direction` (6,), at most what a covariance (6, 6) holds."""
    squares, axes = np.linalg.eigh(covariance)
    held = squares > 1e-15 * squares[-1]
    known = float(((direction @ axes)[held] ** 2 / squares[held]).sum())
    return min(variance, 1 / known) if known > 0 else 0.0


def square_root(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """What each of P independent errors of deviation 1 adds, (P, P), so that they have a covariance (P, P)."""
    squares, axes = np.linalg.eigh(covariance)
    root: NDArray[np.float64] = axes * np.sqrt(np.maximum(squares, 0.0))
    return root
