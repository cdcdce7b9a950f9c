"""Kalman filter of the map's scale, for a source whose errors are alike from one frame to the next."""

from __future__ import annotations

import math

from fvslam_graph.core.config import ScaleSettings
from fvslam_graph.core.gates import chi2_gate
from fvslam_graph.core.gaussian_pose import LogScale

SCALE_GATE = chi2_gate(0.9999, 1)


class ScaleFilter:
    """The scale that a map carries, measured on a ground that is not quite the plane it is taken for.

    A road is not a plane, and the camera pitches against it: what one view of it tells wrong, its neighbours tell wrong
    too. Taken as independent, such measurements would pull the scale along with every hump. So this bias is a second
    state, which decays (first-order Gauss-Markov): the filter takes up what stays when the ground changes.

    Args:
        settings: Size of the bias and over how many keyframes it lasts.
    """

    def __init__(self, settings: ScaleSettings) -> None:
        self.bias_variance = settings.bias_sigma**2  # of the bias where nothing is known of it
        self.bias_decay = math.exp(-1 / settings.bias_correlation_keyframes)  # from one keyframe to the next
        self._bias = LogScale(0.0, self.bias_variance)
        self._covariance = 0.0  # of the scale and the bias

    def forget(self) -> None:
        """The scale that comes next has nothing to do with the last one."""
        self._covariance = 0.0

    def update(self, predicted: LogScale, measured: LogScale | None) -> LogScale:
        """The scale after one more keyframe.

        Args:
            predicted: As the map has it.
            measured: As the source has it, with its own variance alone; None where it does not speak.
        """
        decay, variance = self.bias_decay, self.bias_variance
        bias = LogScale(decay * self._bias.mean, decay**2 * self._bias.variance + (1 - decay**2) * variance)
        covariance = decay * self._covariance
        if measured is None:
            self._bias, self._covariance = bias, covariance
            return predicted
        cross_scale, cross_bias = predicted.variance + covariance, bias.variance + covariance
        S = cross_scale + cross_bias + measured.variance
        innovation = measured.mean - predicted.mean - bias.mean
        if innovation**2 > SCALE_GATE * S:
            # One of the two is wrong, and the next measurement tells which.
            self._bias, self._covariance = bias, covariance
            return LogScale(predicted.mean, predicted.variance + (innovation / 2) ** 2)
        whitened = innovation / S
        self._bias = LogScale(bias.mean + cross_bias * whitened, bias.variance - cross_bias**2 / S)
        self._covariance = covariance - cross_scale * cross_bias / S
        return LogScale(predicted.mean + cross_scale * whitened, predicted.variance - cross_scale**2 / S)
