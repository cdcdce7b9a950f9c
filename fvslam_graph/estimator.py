"""The paper's Fig. 1: visual odometry on every frame, visual SLAM on every k-th, and the fusion of both."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from threadpoolctl import ThreadpoolController

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.choices import Mode, ScaleSource
from fvslam_graph.core.config import Config
from fvslam_graph.core.errors import ConfigError
from fvslam_graph.core.frame_result import Ending, FrameResult
from fvslam_graph.core.gaussian_pose import UNINFORMATIVE_VARIANCE
from fvslam_graph.core.known_points import KnownPoints
from fvslam_graph.core.landmark_finder import LandmarkFinder
from fvslam_graph.core.modes import outside_mode
from fvslam_graph.core.outside import OutsideSteps
from fvslam_graph.core.plugins import Kind
from fvslam_graph.core.sequence import DuplicateFilter, Frame, Ground, Sequence
from fvslam_graph.core.slam_estimate import LandmarkObservations, MatchOutcome, SlamEstimate
from fvslam_graph.core.stopwatch import Stopwatch
from fvslam_graph.core.tracks import FeatureTracker, Tracks
from fvslam_graph.core.trajectory import Status
from fvslam_graph.core.vo_estimate import OdometryMotion, VoEstimate
from fvslam_graph.fusion.fusion import Fusion, RuleFusion, SlamAlone
from fvslam_graph.fusion.graph_fusion import GraphFusion
from fvslam_graph.fusion.rules import Average, FusionRule, Intersection, OutsideRule
from fvslam_graph.fusion.schedule import InterleaveSchedule
from fvslam_graph.slam.patch_finder import PatchFinder
from fvslam_graph.slam.vslam import VSlam
from fvslam_graph.vo.odometry import VisualOdometry
from fvslam_graph.vo.online_calibration import CalibrationCorrection, OnlineCalibration

_log = logging.getLogger(__name__)

VO_STAGES = ("association", "pose", "scale", "detection")
SLAM_STAGES = ("filter", "search", "map", "fusion")


@dataclass(frozen=True)
class FrontEnd:
    """What replaces the eyes of an estimator; by default it looks at images.

    Attributes:
        tracker: Finds points for odometry,
        finder: and for visual SLAM.
        baseline: What the scale source `oracle` says of the distance between two frames by index, metres.
    """

    tracker: FeatureTracker | None = None
    finder: LandmarkFinder | None = None
    baseline: Callable[[int, int], float] | None = None


def stages(config: Config) -> tuple[str, ...]:
    """The stages that a frame's time is made up of."""
    return ("read", *VO_STAGES) if config.mode == Mode.VO else ("read", *VO_STAGES, *SLAM_STAGES)


class FrameEstimator:
    """The configured mode, frame by frame.

    Args:
        camera: The camera of the rectified images.
        config: Mode, settings and seed, as `resolve_config` leaves them.
        ground: What is known of the ground plane.
        front_end: What is seen, in place of images.
        rule: Fuses, in place of that of the mode.
    """

    def __init__(
        self,
        camera: Camera,
        config: Config,
        ground: Ground | None = None,
        front_end: FrontEnd | None = None,
        rule: FusionRule | None = None,
    ) -> None:
        if config.mode != Mode.VO:
            import scipy.linalg  # noqa: F401  its BLAS has to be there to be held to one thread
        self._blas = ThreadpoolController()
        front_end = front_end or FrontEnd()
        self.config = config
        begin_vo = partial(VisualOdometry, camera, config, ground, front_end.baseline, front_end.tracker)
        self._vo = begin_vo()
        self._metres = _MetricRecovery(begin_vo, possible=not config.needs_odometry and not config.scale.relative)
        finder = front_end.finder or PatchFinder(camera, config.features, config.slam)
        self._vslam = VSlam(camera, config.slam, finder, np.random.default_rng([config.seed, 1]))
        self._fusion = _fusion(camera, config, ground) if rule is None else RuleFusion(rule)
        self._schedule = InterleaveSchedule(config.interleave, config.slam.shorten)
        self._duplicates = DuplicateFilter()
        self._calibration = OnlineCalibration(camera, config.vo.calibrate and front_end.tracker is None)
        self._stamps: list[float] = []  # of all frames

    def step(self, frame: Frame) -> FrameResult:
        """Estimate the pose of the next frame; frames come in the order of their stamps, numbered from 0."""
        with self._one_thread():
            return self._step(frame)

    def finish(self) -> Ending | None:
        """What all frames together say; None where the mode does not smooth."""
        if self.config.mode != Mode.VO and self._stamps and not self._vslam.started:
            _log.warning("visual SLAM never began, for want of a map beyond doubt: all poses are those of odometry")
        with self._one_thread():
            return self._fusion.finish()

    def _one_thread(self) -> AbstractContextManager[object]:
        """Matrices are small: a second thread costs more than it brings, and sums would depend on the machine."""
        limit: AbstractContextManager[object] = self._blas.limit(limits=1, user_api="blas")
        return limit

    def _step(self, frame: Frame) -> FrameResult:
        """Fig. 1 of the paper."""
        config, vslam, fusion = self.config, self._vslam, self._fusion
        stopwatch = Stopwatch()
        filed = self._duplicates.filtered(frame)
        frame = self._calibration.rectified(filed)
        self._stamps.append(frame.stamp)

        # O_f: visual odometry, on every frame.
        odometry: VoEstimate | None = None
        if config.needs_odometry or not vslam.started:
            odometry = self._vo.step(frame, vslam.tracks if config.tracks_excluded else None)
            previous, motion, status = odometry.previous, odometry.prev_T_cur, odometry.status
            fusion.add_odometry(frame, replace(odometry.step, calibration=self._calibration.applied))

        # S_f: visual SLAM, on every k-th frame, from where odometry first knows enough to start it.
        slam: SlamEstimate | None = None
        if config.mode != Mode.VO and not vslam.started and odometry is not None:
            slam = self._start(frame, odometry)
            if slam is not None:
                fusion.start(slam.pose, self._filed(slam.observations))
        elif config.mode != Mode.VO and frame.index - vslam.index >= self._schedule.distance:
            prior = fusion.motion if config.odometry_is_prior else None
            slam = vslam.step(frame, prior, self._followed(odometry))
            previous, status, found = slam.previous, slam.status, slam.status is Status.TRACKED
            self._schedule.report(well=found)

            # P_f: both fused, and the reference from which both go on.
            with stopwatch.stage("fusion"):
                motion = fusion.fuse(slam.pose, slam.prev_T_cur, self._filed(slam.observations) if found else None)
            if config.mode != Mode.VSLAM:
                vslam.reset_pose(fusion.reference)

            anew = self._in_metres_again(frame, status)
            slam = replace(anew, previous=previous, prev_T_cur=motion, status=status) if anew else slam

        if odometry is not None and (correction := self._calibration.add(odometry.evidence)):
            slam = self._recalibrate(filed, odometry, correction, slam)
        self._vo.correct_scale(self._calibration.left)

        if status is Status.TRACKED and odometry is not None and not odometry.scale_known:
            status = Status.UNSCALED
        times = dict.fromkeys(stages(config), 0.0) | stopwatch.times
        times |= (odometry.times if odometry else {}) | (slam.times if slam else {})
        measures = _measures(config, odometry, slam)
        tracks = Tracks.none() if odometry is None else odometry.tracks
        return FrameResult(
            frame.index, frame.stamp, fusion.pose, status, previous, motion, measures, times, slam, fusion.enu, tracks
        )

    def _start(self, frame: Frame, odometry: VoEstimate) -> SlamEstimate | None:
        """Begin visual SLAM where odometry knows enough points beyond doubt, and the scale source has spoken."""
        points, seconds = odometry.points, frame.stamp - self._stamps[odometry.previous]
        if odometry.status is not Status.TRACKED or odometry.map_is_doubtful:
            return None
        if len(points) < self.config.slam.min_landmarks:
            return None
        if points.log_variance >= UNINFORMATIVE_VARIANCE and not self.config.scale.relative:
            return None
        motion = OdometryMotion.of(odometry.prev_T_cur, points.log_variance)
        return self._vslam.start(frame, self._fusion.pose, motion, seconds, points)

    def _followed(self, odometry: VoEstimate | None) -> KnownPoints | None:
        """What landmarks are followed by between two turns of visual SLAM."""
        if odometry is None or self.config.slam.association == "search" or odometry.status is not Status.TRACKED:
            return None
        return odometry.points

    def _recalibrate(
        self, filed: Frame, odometry: VoEstimate, correction: CalibrationCorrection, slam: SlamEstimate | None
    ) -> SlamEstimate | None:
        """Go on with images rectified otherwise: odometry with what it knows, visual SLAM with a new map."""
        frame = self._calibration.rectified(filed)
        tracks = replace(odometry.tracks, current=self._calibration.moved(odometry.tracks.current))
        odometry = replace(odometry, tracks=tracks)
        self._vo.recalibrate(frame, odometry)
        self._fusion.calibrate(correction.news)
        anew = self._start(frame, odometry) if self._vslam.started else None
        if anew is not None and slam is None:
            self._fusion.start(anew.pose, self._filed(anew.observations))
        return slam or anew

    def _filed(self, views: LandmarkObservations) -> LandmarkObservations:
        """Where landmarks are in the images of the file, for whose calibration fusion has a variable."""
        return replace(views, pixels=self._calibration.filed(views.pixels))

    def _in_metres_again(self, frame: Frame, status: Status) -> SlamEstimate | None:
        """Begin visual SLAM alone anew where it had lost the metres, and odometry has found them."""
        odometry = self._metres.step(frame, status)
        anew = None if odometry is None else self._start(frame, odometry)
        if anew is not None:
            self._metres.stop()
        return anew


def estimate(sequence: Sequence, config: Config, front_end: FrontEnd | None = None) -> Iterator[FrameResult]:
    """Run the configured mode over a sequence: one result a frame, in order, as soon as it is known.

    Args:
        sequence: Its frames are read one by one.
        config: Mode, settings and seed.
        front_end: What is seen, in place of images.

    Raises:
        ConfigError: The scale source needs what the sequence does not have.
    """
    return through(frame_estimator(sequence, config, front_end), sequence)


def through(estimator: FrameEstimator | OutsideSteps, sequence: Sequence) -> Iterator[FrameResult]:
    """Estimate all frames of a sequence, which are read one by one; the result of each as soon as it is known."""
    for index in range(len(sequence)):
        stopwatch = Stopwatch()
        with stopwatch.stage("read"):
            frame = sequence.frame(index)
        result = estimator.step(frame)
        yield replace(result, times=dict(result.times) | stopwatch.times)


def frame_estimator(
    sequence: Sequence, config: Config, front_end: FrontEnd | None = None
) -> FrameEstimator | OutsideSteps:
    """The estimator for a sequence; arguments as for `estimate`."""
    front_end = front_end or FrontEnd(baseline=_true_baseline(sequence, config))
    return begin(sequence.camera, config, sequence.ground, front_end)


def begin(
    camera: Camera, config: Config, ground: Ground | None = None, front_end: FrontEnd | None = None
) -> FrameEstimator | OutsideSteps:
    """The estimator of the configured mode, ours or that of another package; arguments as for `FrameEstimator`.

    Raises:
        ConfigError: It is a function, which wants the whole sequence.
    """
    outside = outside_mode(config.mode)
    if outside is None or outside.kind is Kind.RULE:
        return FrameEstimator(camera, config, ground, front_end)
    if outside.is_method:
        raise ConfigError(f"the estimator '{config.mode}' is made for whole sequences, not for one frame after another")
    return OutsideSteps(config.mode, outside.make(camera, ground, config.seed))


class _MetricRecovery:
    """Odometry beside visual SLAM alone, from where this has made a map on its own, which knows no metres.

    Args:
        begin: Makes odometry that begins anew.
        possible: Whether odometry can tell metres, and does not run anyway.
    """

    def __init__(self, begin: Callable[[], VisualOdometry], possible: bool) -> None:
        self._begin, self._possible = begin, possible
        self._vo: VisualOdometry | None = None

    def step(self, frame: Frame, status: Status) -> VoEstimate | None:
        """Estimate the motion of a frame where metres are missing, which visual SLAM had with this status."""
        if self._possible and self._vo is None and status is Status.REINITIALISED:
            self._vo = self._begin()
        return None if self._vo is None else self._vo.step(frame)

    def stop(self) -> None:
        """Leave off: visual SLAM knows metres again."""
        self._vo = None


def _fusion(camera: Camera, config: Config, ground: Ground | None) -> Fusion:
    """The fusion of the mode; in mode `vo` there is nothing to fuse."""
    if config.mode == Mode.GRAPH:
        scale = config.scale
        return GraphFusion(camera, config.graph, ground, scale.relative, scale.ground.roughness)
    if config.mode == Mode.INTERSECTION:
        return RuleFusion(Intersection(config.fusion.criterion))
    if config.mode == Mode.AVERAGE:
        return RuleFusion(Average(config.fusion.weight, config.fusion.geodesic))
    if (outside := outside_mode(config.mode)) is not None:
        return RuleFusion(OutsideRule(config.mode, outside.make()))
    return SlamAlone()


def _true_baseline(sequence: Sequence, config: Config) -> Callable[[int, int], float] | None:
    """Distance between two frames by the ground truth, for the scale source `oracle` and for it alone."""
    if config.scale.source is not ScaleSource.ORACLE or sequence.ground_truth is None:
        return None
    truth = sequence.ground_truth.interpolate(sequence.stamps)
    position = dict(zip(truth.stamps, truth.positions, strict=True))

    def distance(a: int, b: int) -> float:
        start, end = position.get(sequence.stamps[a]), position.get(sequence.stamps[b])
        return math.nan if start is None or end is None else float(np.linalg.norm(end - start))

    return distance


def _measures(config: Config, odometry: VoEstimate | None, slam: SlamEstimate | None) -> dict[str, float]:
    """Columns of frames.csv; NaN for a block that did not run on this frame."""
    scale = odometry.scale.length if odometry and odometry.scale else None
    measures = {
        "tracks": math.nan if odometry is None else odometry.found,
        "inliers": math.nan if odometry is None else len(odometry.tracks),
        "keyframe": math.nan if odometry is None else odometry.previous,
        "scale": scale.metres if scale else math.nan,
        "scale_sigma": scale.metres * math.sqrt(scale.variance) if scale else math.nan,
        "parallax_px": math.nan if odometry is None else odometry.parallax,
    }
    if config.mode == Mode.VO:
        return measures
    outcomes = (
        np.bincount(slam.matches.outcome, minlength=len(MatchOutcome)) if slam else np.full(len(MatchOutcome), math.nan)
    )
    expected = outcomes[
        [MatchOutcome.UNMATCHED, MatchOutcome.REJECTED, MatchOutcome.INLIER, MatchOutcome.RESCUED]
    ].sum()
    return measures | {
        "landmarks": float(expected),
        "matched": float(expected - outcomes[MatchOutcome.UNMATCHED]),
        "measured": float(outcomes[MatchOutcome.INLIER] + outcomes[MatchOutcome.RESCUED]),
        "nis": slam.matches.nis if slam else math.nan,
        "interval": slam.index - slam.previous if slam else math.nan,
        "map_scale_sigma": slam.scale_sigma if slam else math.nan,
    }
