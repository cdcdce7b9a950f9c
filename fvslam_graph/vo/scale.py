"""Metres per unit baseline: one camera has no scale of its own, so it comes from a source."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.config import ScaleSettings, ScaleSource
from fvslam_graph.sequences.base import Frame
from fvslam_graph.vo.depth import InverseDepths
from fvslam_graph.vo.ground import GroundAligner
from fvslam_graph.vo.two_view import TwoView

ORACLE_VARIANCE = 1e-6  # of log scale: 0.1 %
MIN_COMMON = 10  # tracks of known depth that tell a scale


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

    def fused(self, other: LogScale) -> LogScale:
        """The product of two independent estimates, as in a Kalman update."""
        gain = self.variance / (self.variance + other.variance)
        return LogScale(self.mean + gain * (other.mean - self.mean), (1 - gain) * self.variance)


class MetricScale:
    """The scale of each new baseline, from the configured source.

    Args:
        settings: Which source, and its uncertainty.
        aligner: Measures the ground plane; needed by the source `plane`.
        true_baseline: Distance in metres between two frames by index; needed by the source `oracle`.
    """

    def __init__(
        self,
        settings: ScaleSettings,
        aligner: GroundAligner | None,
        true_baseline: Callable[[int, int], float] | None,
    ) -> None:
        self.settings = settings
        self._aligner = aligner
        self._true_baseline = true_baseline

    def from_map(self, unit: InverseDepths, known: InverseDepths, variance: float) -> LogScale | None:
        """Scale at which newly triangulated depths agree with known ones; None with too few points in common.

        Args:
            unit: Depths in units of the new baseline.
            known: Depths in metres, in the same camera.
            variance: Of the log scale that the known depths share.
        """
        mine, theirs = unit.common(known.ids)
        unit, known = unit[mine], known[theirs]
        usable = (unit.values > unit.sigmas) & (known.values > known.sigmas)
        if usable.sum() < MIN_COMMON:
            return None
        unit, known = unit[usable], known[usable]
        log_ratio = np.log(unit.values / known.values)
        sigma = np.hypot(unit.sigmas / unit.values, known.sigmas / known.values)
        mean = float(np.median(log_ratio))
        for _ in range(10):
            weight = 1 / (sigma**2 * (1 + ((log_ratio - mean) / sigma / 2) ** 2))
            mean = float((weight * log_ratio).sum() / weight.sum())
        spread = float((weight**2 * (log_ratio - mean) ** 2).sum() / weight.sum() ** 2)
        return LogScale(mean, variance + spread + self.settings.map_sigma**2)

    def estimate(
        self,
        previous: Frame,
        current: Frame,
        two_view: TwoView,
        rays: NDArray[np.float64],
        unit: InverseDepths,
        predicted: LogScale | None,
        rng: np.random.Generator,
    ) -> LogScale:
        """Scale of the baseline between two frames.

        Args:
            previous, current: The two frames.
            two_view: Their relative pose.
            rays: (N, 3) of the tracks in the previous frame.
            unit: (N,) depths of these tracks in baselines.
            predicted: What the map, or else the speed, says beforehand.
            rng: For the ground plane's hypotheses.
        """
        source = self.settings.source
        if source is ScaleSource.UNIT:
            return LogScale(0.0, 1.0)
        if self._true_baseline is not None:
            baseline = self._true_baseline(previous.index, current.index)
            measured = LogScale(math.log(baseline), ORACLE_VARIANCE) if baseline > 0 else None
        else:
            measured = self._from_plane(previous, current, two_view, rays, unit, predicted, rng)
        if measured is None:
            return predicted or LogScale(0.0, 1.0)
        return measured if predicted is None else predicted.fused(measured)

    def _from_plane(
        self,
        previous: Frame,
        current: Frame,
        two_view: TwoView,
        rays: NDArray[np.float64],
        unit: InverseDepths,
        predicted: LogScale | None,
        rng: np.random.Generator,
    ) -> LogScale | None:
        height = previous.height
        if self._aligner is None or previous.image is None or current.image is None or not height > 0:
            return None
        guess = None if predicted is None else predicted.metres / height
        ground = self._aligner.measure(previous.image, current.image, two_view, rays, unit, guess, rng)
        if ground is None:
            return None
        log_scale = math.log(height * float(np.linalg.norm(ground.plane)))
        return LogScale(log_scale, ground.log_variance + self.settings.plane_sigma**2)
