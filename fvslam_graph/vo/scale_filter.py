"""Kalman filter of the map's scale, for a source whose errors are alike from one frame to the next."""

from __future__ import annotations

import math

from fvslam_graph.core.config import ScaleSettings
from fvslam_graph.core.gaussian_pose import LogScale

GATE = 15.1  # squared deviations: chi-square with one degree of freedom is beyond it once in ten thousand


class ScaleFilter:
    """The scale that a map carries, measured on a ground that is not quite the plane it is taken for.

    A road is not a plane, and the camera pitches against it: what one view of it tells wrong, its neighbours tell wrong
    too. Taken as independent, such measurements would pull the scale along with every hump. So what they share is a
    second state, which decays (first-order Gauss-Markov): the filter takes up what stays when the ground changes.

    Args:
        settings: Size of the shared error and over how many keyframes it lasts.
    """

    def __init__(self, settings: ScaleSettings) -> None:
        self.variance = settings.bias_sigma**2  # of the shared error where nothing is known of it
        self.decay = math.exp(-1 / settings.bias_correlation_keyframes)  # from one keyframe to the next
        self._shared = LogScale(0.0, self.variance)
        self._covariance = 0.0  # of the scale and the shared error

    def forget(self) -> None:
        """The scale that comes next has nothing to do with the last one."""
        self._covariance = 0.0

    def update(self, predicted: LogScale, measured: LogScale | None) -> LogScale:
        """The scale after one more keyframe.

        Args:
            predicted: As the map has it.
            measured: As the source has it, with its own variance alone; None where it does not speak.
        """
        decay, variance = self.decay, self.variance
        shared = LogScale(decay * self._shared.mean, decay**2 * self._shared.variance + (1 - decay**2) * variance)
        covariance = decay * self._covariance
        if measured is None:
            self._shared, self._covariance = shared, covariance
            return predicted
        by_scale, by_shared = predicted.variance + covariance, shared.variance + covariance
        spread = by_scale + by_shared + measured.variance
        difference = measured.mean - predicted.mean - shared.mean
        if difference**2 > GATE * spread:
            # One of the two is wrong, and the next measurement tells which.
            self._shared, self._covariance = shared, covariance
            return LogScale(predicted.mean, predicted.variance + (difference / 2) ** 2)
        surprise = difference / spread
        self._shared = LogScale(shared.mean + by_shared * surprise, shared.variance - by_shared**2 / spread)
        self._covariance = covariance - by_scale * by_shared / spread
        return LogScale(predicted.mean + by_scale * surprise, predicted.variance - by_scale**2 / spread)
