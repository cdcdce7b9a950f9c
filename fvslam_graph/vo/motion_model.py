"""Constant velocity: what carries on when an image tells too little."""

from __future__ import annotations

import math

import gtsam
import numpy as np

from fvslam_graph.config import VoSettings
from fvslam_graph.estimates import GaussianPose, LogScale

UNKNOWN_VELOCITY = (1.0, 10.0)  # rad/s, m/s, standard deviations before anything was measured


class ConstantVelocity:
    """Camera motion with white acceleration, in the camera's own frame.

    Args:
        settings: Standard deviations of the accelerations.
    """

    def __init__(self, settings: VoSettings) -> None:
        self.settings = settings
        self.twist = np.zeros(6)  # rad/s, m/s
        self.log_variance = 0.0  # of the scale of the velocity
        self._known = False  # whether it was ever measured

    def distance(self, seconds: float) -> LogScale | None:
        """Length of the path over a time; None where the camera stood."""
        metres = float(np.linalg.norm(self.twist[3:])) * seconds
        if metres < 1e-3:
            return None
        sigma = 0.5 * self.settings.max_acceleration * seconds**2
        return LogScale(math.log(metres), self.log_variance + (sigma / metres) ** 2)

    def observe(self, last_T_cur: gtsam.Pose3, seconds: float, log_variance: float) -> None:
        """Take over the velocity of a measured motion, whose scale has a variance."""
        self.twist = gtsam.Pose3.Logmap(last_T_cur) / seconds
        self.log_variance = log_variance
        self._known = True

    def stop(self) -> None:
        """The camera stands still."""
        self.twist = np.zeros(6)
        self._known = True

    def predict(self, seconds: float) -> GaussianPose:
        """Motion over a time; its covariance grows with the fourth power of the time."""
        accelerations = np.repeat([self.settings.max_angular_acceleration, self.settings.max_acceleration], 3)
        sigmas = 0.5 * seconds**2 * accelerations
        if not self._known:
            sigmas += seconds * np.repeat(UNKNOWN_VELOCITY, 3)
        return GaussianPose(gtsam.Pose3.Expmap(self.twist * seconds), np.diag(sigmas**2))
