"""Poses with their covariances: what the blocks hand to each other."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import gtsam
import numpy as np
from numpy.typing import NDArray

VAGUE = 0.2**2  # variance of the logarithm of a scale from which on it tells nothing


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

    def compose(self, step: GaussianPose) -> GaussianPose:
        """a_T_c of this a_T_b and an independent b_T_c; to first order."""
        adjoint = step.mean.inverse().AdjointMap()
        covariance = adjoint @ self.covariance @ adjoint.T + step.covariance
        return GaussianPose(self.mean.compose(step.mean), (covariance + covariance.T) / 2)

    def with_scale_variance(self, variance: float) -> GaussianPose:
        """The same with so much more variance of the logarithm of its length; less, where it is negative."""
        travel = np.concatenate([np.zeros(3), self.mean.rotation().unrotate(self.mean.translation())])
        return GaussianPose(self.mean, self.covariance + variance * np.outer(travel, travel))

    def inverse(self) -> GaussianPose:
        """b_T_a."""
        adjoint = self.mean.AdjointMap()
        covariance = adjoint @ self.covariance @ adjoint.T
        return GaussianPose(self.mean.inverse(), (covariance + covariance.T) / 2)


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


@dataclass(frozen=True)
class ScaleStep:
    """Where the scale of a baseline comes from: what a filter of the scale, or a smoother, needs to know of one step.

    Attributes:
        length: What odometry makes of it all: log(metres) of the baseline.
        carried: What the map says, in the scale that the last baseline had; the variance is what the step adds.
        measured: What the scale source says, with the variance of what is new in it; None where it does not speak.
        shared: Variance of what the source errs likewise in neighbouring steps,
        lasting: and the share of this error that lasts to the next step.
    """

    length: LogScale
    carried: LogScale
    measured: LogScale | None = None
    shared: float = 0.0
    lasting: float = 0.0


@dataclass(frozen=True)
class Views:
    """What one image shows of N landmarks.

    Attributes:
        ids: (N,) the same for the same landmark at all times.
        pixels: (N, 2) where they are.
        points: (N, 3) where they are in the camera as visual SLAM has it, metres; NaN where it has dropped them.
        covariances: (N, 3, 3) of the points.
    """

    ids: NDArray[np.int64]
    pixels: NDArray[np.float64]
    points: NDArray[np.float64]
    covariances: NDArray[np.float64]
