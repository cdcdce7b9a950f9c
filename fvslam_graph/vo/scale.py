"""Metres per unit baseline: one camera has no scale of its own, so it comes from a source."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fvslam_graph.core.choices import ScaleSource
from fvslam_graph.core.config import ScaleSettings
from fvslam_graph.core.errors import ConfigError
from fvslam_graph.core.gaussian_pose import UNINFORMATIVE_VARIANCE, LogScale
from fvslam_graph.core.inverse_depths import MetricMap
from fvslam_graph.core.sensors import GRAVITY_SIGMA
from fvslam_graph.core.vo_estimate import ScaleStep
from fvslam_graph.vo.depth import scale_ratio
from fvslam_graph.vo.ground_plane import GroundAligner
from fvslam_graph.vo.relative_pose import TwoViews
from fvslam_graph.vo.scale_filter import GroundScale, ScaleFilter

ORACLE_VARIANCE = 1e-6  # of log scale: 0.1 %


class MetricScale:
    """The scale of each new baseline, from the configured source.

    Args:
        settings: Which source, and its uncertainty.
        aligner: Measures the ground plane; needed by the source `plane`.
        true_baseline: Distance in metres between two frames by index; needed by the source `oracle`.
        common_sigma: Of the logarithm of heights, of an error that all have in common.

    Raises:
        ConfigError: The source is `oracle` and there are no true baselines.
    """

    def __init__(
        self,
        settings: ScaleSettings,
        aligner: GroundAligner | None,
        true_baseline: Callable[[int, int], float] | None,
        common_sigma: float = 0.0,
    ) -> None:
        if settings.source is ScaleSource.ORACLE and true_baseline is None:
            raise ConfigError("the scale source 'oracle' needs the true baselines")
        self.settings = settings
        self._aligner = aligner
        self._true_baseline = true_baseline
        self._filter = ScaleFilter(settings, common_sigma)
        self.calibration = np.zeros(2)  # what is to be added to the images', for the scale that the map carries

    def estimate(
        self, views: TwoViews, known: MetricMap, fallback: LogScale, rng: np.random.Generator
    ) -> tuple[ScaleStep, MetricMap]:
        """Scale of the baseline between two frames, and the map with this scale.

        The map predicts the scale, the source measures it, and a Kalman filter fuses both: so one source pools many
        frames. What is learnt holds for the whole map, as all its depths share one scale.

        Args:
            views: The two frames.
            known: The map in the previous frame.
            fallback: Prediction where the map has too few points in common.
            rng: For the ground plane's hypotheses.

        Returns:
            The scale and how it came about; and the map in the previous frame, rescaled and with the new depths.
        """
        ratio = scale_ratio(views.depths, known.depths)
        if ratio is None:
            predicted = transition = fallback
            self._filter.begin(fallback.variance)
        else:
            # By a wrong calibration, new depths are wrong otherwise than old ones: in a turn, the scale drifts.
            mean = ratio.scale.mean + float(ratio.J_calibration @ self.calibration)
            self._filter.carry(known.variance, ratio.scale.variance)
            transition = LogScale(mean, ratio.scale.variance + self.settings.map_sigma**2)
            predicted = LogScale(mean, transition.variance + known.variance)
        if self.settings.source is ScaleSource.UNIT:
            scale = LogScale(0.0, 1.0)
            step = ScaleStep(scale, predicted=scale)
        elif self.settings.source is ScaleSource.ORACLE:
            assert self._true_baseline is not None
            baseline = self._true_baseline(views.previous.index, views.current.index)
            measured = LogScale(math.log(baseline), ORACLE_VARIANCE) if baseline > 0 else None
            scale = measured or predicted
            step = ScaleStep(scale, transition, measured)
        else:
            plane = self._from_plane(views, predicted, rng)
            scale = self._filter.update(predicted.mean, plane)
            step = self._smoothing_step(scale, transition, plane, views.previous.height_sigma)
        old = known.depths
        if ratio is not None:
            step = replace(step, J_predicted=ratio.J_calibration, calibration=self.calibration)
            old = old.scaled(scale.metres / ratio.scale.metres, -ratio.J_calibration)
        new = views.depths.scaled(scale.metres)
        return step, MetricMap(old.fused(new[new.values > 0]), scale.variance)

    def _smoothing_step(
        self, scale: LogScale, transition: LogScale, plane: GroundScale | None, height_sigma: float
    ) -> ScaleStep:
        """What a smoother takes: the ground at its roughest, unless heights come with a deviation.

        Landmarks carry the scale there as well. Ground that counts for what it tells brings metres nearer, but path and
        landmarks follow its hills (docs/decisions/scale-filter.md).
        """
        bias_sigma, plane_sigma = self.settings.bias_sigma, self.settings.plane_sigma
        share = plane.roughness if plane is not None and height_sigma > 0 else 1.0
        measured = None if plane is None else replace(plane, roughness=share).measurement(plane_sigma)
        decay, common_variance = self._filter.bias_decay, self._filter.common_variance
        step = ScaleStep(scale, transition, measured, (share * bias_sigma) ** 2, decay, common_variance)
        return step if plane is None else replace(step, J_measured=plane.J_calibration)

    def _from_plane(self, views: TwoViews, predicted: LogScale, rng: np.random.Generator) -> GroundScale | None:
        """The scale by one view of the ground."""
        previous, height = views.previous, views.previous.height
        if self._aligner is None or previous.image is None or views.current.image is None or not height > 0:
            return None
        expected = predicted.metres / height if predicted.variance < UNINFORMATIVE_VARIANCE else None
        aligner = self._aligner
        if previous.gravity is not None:
            aligner = aligner.towards(previous.gravity, GRAVITY_SIGMA)
        ground = aligner.measure(views, expected, rng)
        if ground is None:
            return None
        variance = ground.log_variance + (previous.height_sigma / height) ** 2
        mean = math.log(height * float(np.linalg.norm(ground.plane)))
        return GroundScale(mean, variance, ground.roughness, ground.J_calibration)
