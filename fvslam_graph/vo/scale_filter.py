"""Kalman filter of the map's scale, for a source whose errors are alike from one frame to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.config import ScaleSettings
from fvslam_graph.core.gates import chi2_gate
from fvslam_graph.core.gaussian_pose import LogScale

SCALE_GATE = chi2_gate(0.9999, 1)
# Drifts of the carried scale that are tried, in usual ones: before anything is measured, their mean square is that.
DRIFTS = np.array([0.1, 0.3, 1.0, 2.9**0.5])
UNLIKELY = -7.0  # logarithm of a weight that none falls below, as the drift may change


@dataclass(frozen=True)
class GroundScale:
    """The scale by one view of the ground.

    Attributes:
        mean: Logarithm of the metres of a baseline.
        variance: Of this, without what the ground lies off the plane that it is taken for.
        roughness: How far it does, as a share of what is usual at most.
        J_calibration: (2,) how the mean changes with the logarithm of the focal length and with k1.
    """

    mean: float
    variance: float
    roughness: float
    J_calibration: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))

    def measurement(self, plane_sigma: float) -> LogScale:
        """What is new in this view, as a measurement: on the roughest ground it errs by `plane_sigma` for itself."""
        return LogScale(self.mean, self.variance + (self.roughness * plane_sigma) ** 2)


class ScaleFilter:
    """The scale that a map carries, measured on a ground that is not quite the plane it is taken for.

    A road is not a plane, and the camera pitches against it: what one view of it tells wrong, its neighbours tell wrong
    too. Taken as independent, such measurements would pull the scale along with every hump. So this bias is a second
    state, which decays (first-order Gauss-Markov): the filter takes up what stays when the ground changes. Its size is
    seen in each view: as far as patches lie off the plane, the plane lies off the ground below the camera.

    How much a carried scale drifts differs between recordings by ten times. Filters of several drifts run side by side,
    each counting for how likely it makes what was measured (Magill 1965).

    Args:
        settings: Sizes of the bias and the drift, and over how many keyframes the bias lasts.
        common_sigma: Of an error that all measurements have in common. Nothing here tells it.
    """

    def __init__(self, settings: ScaleSettings, common_sigma: float = 0.0) -> None:
        self._settings, self.common_variance = settings, common_sigma**2
        self.bias_decay = math.exp(-1 / settings.bias_correlation_keyframes)  # from one keyframe to the next
        self._drift_variances = (settings.map_sigma * DRIFTS) ** 2
        self._log_weights = np.zeros(len(DRIFTS))
        self._variance = math.nan  # of the scale, as last told
        self._scales = np.zeros(len(DRIFTS))  # against what is predicted, by each filter
        self._biases = np.zeros(len(DRIFTS))  # in their deviations
        self._P_scale, self._P_both, self._P_bias = np.zeros(len(DRIFTS)), np.zeros(len(DRIFTS)), np.ones(len(DRIFTS))

    def begin(self, variance: float) -> None:
        """The scale that comes next has nothing to do with the last one."""
        self._scales[:], self._P_scale[:], self._P_both[:] = 0.0, max(variance - self.common_variance, 0.0), 0.0

    def carry(self, variance: float, added: float) -> None:
        """The scale that comes next is that of a map.

        Args:
            variance: Of the scale of this map.
            added: What the prediction adds to it, besides a drift.
        """
        if variance != self._variance:  # it is another map, or one that has become doubtful
            self.begin(variance)
        self._P_scale += added + self._drift_variances

    def update(self, predicted: float, measured: GroundScale | None) -> LogScale:
        """The scale after one more keyframe.

        Args:
            predicted: Its mean as the map has it.
            measured: As the source has it; None where it does not speak.
        """
        decay = self.bias_decay
        self._biases, self._P_both = decay * self._biases, decay * self._P_both
        self._P_bias = decay**2 * self._P_bias + 1 - decay**2
        if measured is not None:
            self._measure(measured, predicted)
        weights = self._weights()
        mean = float(weights @ self._scales)
        self._variance = float(weights @ (self._P_scale + (self._scales - mean) ** 2)) + self.common_variance
        self._scales -= mean
        return LogScale(predicted + mean, self._variance)

    def _measure(self, ground: GroundScale, predicted: float) -> None:
        measured = ground.measurement(self._settings.plane_sigma)
        bias_sigma = ground.roughness * self._settings.bias_sigma
        cross_scale, cross_bias = self._P_scale + bias_sigma * self._P_both, self._P_both + bias_sigma * self._P_bias
        S = cross_scale + bias_sigma * cross_bias + measured.variance
        innovations = measured.mean - predicted - self._scales - bias_sigma * self._biases
        weights = self._weights()
        innovation = float(weights @ innovations)
        if innovation**2 > SCALE_GATE * float(weights @ (S + (innovations - innovation) ** 2)):
            # One of the two is wrong, and the next measurement tells which.
            self._P_scale += (innovation / 2) ** 2
            return
        self._log_weights -= (np.log(S) + innovations**2 / S) / 2
        self._log_weights = np.maximum(self._log_weights - self._log_weights.max(), UNLIKELY)
        self._scales += cross_scale * innovations / S
        self._biases += cross_bias * innovations / S
        self._P_scale -= cross_scale**2 / S
        self._P_both -= cross_scale * cross_bias / S
        self._P_bias -= cross_bias**2 / S

    def _weights(self) -> NDArray[np.float64]:
        """(D,) of each filter, one together."""
        likelihoods: NDArray[np.float64] = np.exp(self._log_weights)
        return np.asarray(likelihoods / likelihoods.sum())
