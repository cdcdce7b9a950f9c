"""Whether a vehicle can have moved as odometry says."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.estimates import GaussianPose

ACCELERATION = np.repeat([1.0, 3.0], 3)  # rad/s^2 and m/s^2, standard deviations
GATE = 22.458  # 99.9 % quantile of the chi-square distribution with six degrees of freedom
PATIENCE = 4  # implausible motions in a row, after which it is the expectation that is wrong


class Plausibility:
    """Holds each motion against the one before it, at constant velocity up to what forces can change.

    A velocity counts once a second motion has agreed with it.
    """

    def __init__(self) -> None:
        self._velocity: NDArray[np.float64] | None = None  # (6,) rad/s, m/s
        self._agreed = False
        self._age = 0.0  # seconds from the middle of the motion that it was measured over to the newest frame
        self._failures = 0

    def checked(self, prev_T_cur: GaussianPose, seconds: float) -> GaussianPose:
        """The motion over a time; where it cannot be, what the velocity predicts in its place."""
        if not seconds > 0:
            return prev_T_cur
        if self._velocity is not None:
            predicted = gtsam.Pose3.Expmap(self._velocity * seconds)
            covariance = np.diag((ACCELERATION * (self._age + seconds / 2) * seconds) ** 2)
            self._age += seconds
            error = gtsam.Pose3.Logmap(predicted.between(prev_T_cur.mean))
            plausible = error @ np.linalg.solve(covariance + prev_T_cur.covariance, error) < GATE
            self._failures = 0 if plausible else self._failures + 1
            if self._agreed and 0 < self._failures <= PATIENCE:
                return GaussianPose(predicted, covariance)
            self._agreed = bool(plausible)
        self._velocity, self._age = gtsam.Pose3.Logmap(prev_T_cur.mean) / seconds, seconds / 2
        return prev_T_cur
