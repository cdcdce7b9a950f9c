"""Constant velocity: what carries on when an image tells too little, and what measured motions are held against."""

from __future__ import annotations

import math

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.config import VoSettings
from fvslam_graph.core.gaussian_pose import GaussianPose, LogScale

LONGEST = 1e6  # seconds over which anything is predicted: damaged stamps may be any number
UNKNOWN_VELOCITY = (1.0, 10.0)  # rad/s, m/s, standard deviations before anything was measured
PRIOR_SAMPLES = 20  # for which the settings stand among the accelerations of the run
MIN_ACCELERATION = 0.3  # of the settings: a smooth road is no promise
LARGEST_SAMPLE = 3.0  # standard deviations that one of them may count for: a wrong motion teaches little


class ConstantVelocity:
    """Camera motion with white acceleration, in the camera's own frame.

    How large accelerations are is learnt from the run.

    Args:
        settings: Standard deviations of the accelerations, to begin with.
    """

    def __init__(self, settings: VoSettings) -> None:
        self._prior = np.array([settings.max_angular_acceleration, settings.max_acceleration])
        self._squares = PRIOR_SAMPLES * self._prior**2  # summed over the samples
        self._samples = PRIOR_SAMPLES
        self.twist = np.zeros(6)  # rad/s, m/s
        self.log_variance = 0.0  # of the scale of the velocity
        self._covariance = np.zeros((6, 6))  # of the velocity, as it was measured, without its scale
        self._known = False  # whether it was ever measured
        self._age = 0.0  # seconds from when it held, on average, to where predictions start

    @property
    def accelerations(self) -> NDArray[np.float64]:
        """(6,) standard deviations along each axis, rad/s^2 and m/s^2."""
        return np.repeat(np.maximum(np.sqrt(self._squares / self._samples), MIN_ACCELERATION * self._prior), 3)

    def distance(self, seconds: float) -> LogScale | None:
        """Length of the path over a time; None where the camera stood."""
        seconds = min(seconds, LONGEST)
        metres = float(np.linalg.norm(self.twist[3:])) * seconds
        if metres < 1e-3:
            return None
        sigma = float(self.accelerations[3]) * (self._age + seconds / 2) * seconds
        return LogScale(math.log(metres), self.log_variance + (sigma / metres) ** 2)

    def observe(
        self, last_T_cur: GaussianPose, seconds: float, log_variance: float, passed: float | None = None
    ) -> None:
        """Take over the velocity of a measured motion, whose scale has a variance.

        Args:
            last_T_cur: The motion.
            seconds: How long it took,
            passed: and how much of that is after what was taken over before; by default all.
            log_variance: Of its length.
        """
        seconds = min(seconds, LONGEST)
        twist = gtsam.Pose3.Logmap(last_T_cur.mean) / seconds
        between = self._age + seconds / 2 if passed is None else self._age + passed - seconds / 2
        if self._known and between > 0:
            change = (twist - self.twist).reshape(2, 3) / between
            largest = LARGEST_SAMPLE**2 * self._squares / self._samples
            self._squares = self._squares + np.minimum((change**2).mean(axis=1), largest)
            self._samples += 1
        self.twist, self.log_variance = twist, log_variance
        own = last_T_cur.with_scale_variance(-last_T_cur.room_for_scale(log_variance))
        self._covariance = own.covariance / seconds**2
        self._known, self._age = True, seconds / 2

    def stop(self) -> None:
        """The camera stands still, or goes on as before, and an image was delivered twice."""
        self._covariance = np.outer(self.twist, self.twist)
        self.twist = np.zeros(6)
        self._known, self._age = True, 0.0

    def coast(self, seconds: float) -> None:
        """So much time has passed in which nothing was measured, and predictions start from there."""
        self._age = min(self._age + seconds, LONGEST)

    def predict(self, seconds: float) -> GaussianPose:
        """Motion over a time; its covariance grows with the fourth power of the time since the last measurement."""
        seconds = min(seconds, LONGEST)
        sigmas = self.accelerations * (self._age + seconds / 2) * seconds
        if not self._known:
            sigmas += seconds * np.repeat(UNKNOWN_VELOCITY, 3)
        return GaussianPose(
            gtsam.Pose3.Expmap(self.twist * seconds), self._covariance * seconds**2 + np.diag(sigmas**2)
        )
