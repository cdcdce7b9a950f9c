"""The paper's Fig. 1: visual odometry on every frame, visual SLAM on every k-th, and the fusion of both."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fvslam_graph.core.config import Config, Mode, ScaleSource
from fvslam_graph.core.frame_result import FrameResult
from fvslam_graph.core.gaussian_pose import UNINFORMATIVE_VARIANCE, GaussianPose
from fvslam_graph.core.known_points import KnownPoints
from fvslam_graph.core.landmark_finder import LandmarkFinder
from fvslam_graph.core.sequence import DuplicateFilter, Frame, Sequence
from fvslam_graph.core.slam_estimate import MatchOutcome, SlamEstimate
from fvslam_graph.core.stopwatch import Stopwatch
from fvslam_graph.core.tracks import FeatureTracker
from fvslam_graph.core.trajectory import Status
from fvslam_graph.core.vo_estimate import VoEstimate
from fvslam_graph.fusion.fusion import Fusion, RuleFusion, SlamAlone
from fvslam_graph.fusion.graph_fusion import GraphFusion
from fvslam_graph.fusion.rules import Average, Intersection
from fvslam_graph.fusion.schedule import InterleaveSchedule
from fvslam_graph.slam.patch_finder import PatchFinder
from fvslam_graph.slam.vslam import VSlam
from fvslam_graph.vo.odometry import VisualOdometry

VO_STAGES = ("association", "pose", "scale", "detection")
SLAM_STAGES = ("filter", "search", "map", "fusion")


@dataclass(frozen=True)
class FrontEnd:
    """Stands for images: finds what is seen of a simulated scene.

    Attributes:
        tracker: Finds points for odometry,
        finder: and for visual SLAM.
        baseline: What the scale source `oracle` says of the distance between two frames by index, metres.
    """

    tracker: FeatureTracker
    finder: LandmarkFinder
    baseline: Callable[[int, int], float]


def stages(config: Config) -> tuple[str, ...]:
    """The stages that a frame's time is made up of."""
    return ("read", *VO_STAGES) if config.mode is Mode.VO else ("read", *VO_STAGES, *SLAM_STAGES)


def estimate(sequence: Sequence, config: Config, front_end: FrontEnd | None = None) -> Iterator[FrameResult]:
    """Run the configured mode over a sequence: one result a frame, in order, as soon as it is known.

    Args:
        sequence: Its frames are read one by one.
        config: Mode, settings and seed.
        front_end: What is seen, in place of images.

    Raises:
        ConfigError: The scale source needs what the sequence does not have.
    """
    baseline = front_end.baseline if front_end else _true_baseline(sequence, config)
    tracker = front_end.tracker if front_end else None
    begin_vo = partial(VisualOdometry, sequence.camera, config, sequence.ground, baseline, tracker)
    vo = begin_vo()
    metres = _MetricRecovery(begin_vo, possible=not config.needs_odometry and not config.scale.relative)
    finder = front_end.finder if front_end else PatchFinder(sequence.camera, config.features, config.slam)
    vslam = VSlam(sequence.camera, config.slam, finder, np.random.default_rng([config.seed, 1]))
    fusion = _fusion(sequence, config)
    interleave = InterleaveSchedule(config.interleave, config.slam.shorten)
    duplicates = DuplicateFilter()
    for index in range(len(sequence)):
        stopwatch = Stopwatch()
        with stopwatch.stage("read"):
            frame = duplicates.filtered(sequence.frame(index))

        # O_f: visual odometry, on every frame.
        odometry: VoEstimate | None = None
        if config.needs_odometry or not vslam.started:
            odometry = vo.step(frame, vslam.tracks if config.tracks_excluded else None)
            previous, motion, status = odometry.previous, odometry.prev_T_cur, odometry.status
            fusion.add_odometry(frame, odometry.step)

        # S_f: visual SLAM, on every k-th frame, from where odometry first knows enough to start it.
        slam: SlamEstimate | None = None
        if config.mode is not Mode.VO and not vslam.started and odometry is not None:
            slam = _start(vslam, frame, odometry, fusion.pose, sequence, config)
            if slam is not None:
                fusion.start(slam.pose, slam.observations)
        elif config.mode is not Mode.VO and index - vslam.index >= interleave.distance:
            prior = fusion.motion if config.odometry_is_prior else None
            slam = vslam.step(frame, prior, _followed(odometry, config))
            previous, status, found = slam.previous, slam.status, slam.status is Status.TRACKED
            interleave.report(well=found)

            # P_f: both fused, and the reference from which both go on.
            with stopwatch.stage("fusion"):
                motion = fusion.fuse(slam.pose, slam.prev_T_cur, slam.observations if found else None)
            if config.mode is not Mode.VSLAM:
                vslam.reset_pose(fusion.reference)

            if (told := metres.step(frame, status)) is not None:
                anew = _start(vslam, frame, told, fusion.pose, sequence, config)
                if anew is not None:
                    metres.stop()
                    slam = replace(anew, previous=previous, prev_T_cur=motion, status=status)

        times = dict.fromkeys(stages(config), 0.0) | stopwatch.times
        times |= (odometry.times if odometry else {}) | (slam.times if slam else {})
        yield FrameResult(
            index=index,
            stamp=frame.stamp,
            pose=fusion.pose,
            status=status,
            previous=previous,
            relative=motion,
            measures=_measures(config, odometry, slam),
            times=times,
            slam=slam,
            graph=fusion.graph,
        )


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


def _followed(odometry: VoEstimate | None, config: Config) -> KnownPoints | None:
    """The points by which landmarks are followed between two turns of visual SLAM."""
    if odometry is None or config.slam.association == "search" or odometry.status is not Status.TRACKED:
        return None
    return odometry.points


def _fusion(sequence: Sequence, config: Config) -> Fusion:
    """The fusion of the mode; in mode `vo` there is nothing to fuse."""
    if config.mode is Mode.GRAPH:
        scale = config.scale
        return GraphFusion(sequence.camera, config.graph, sequence.ground, scale.relative, scale.ground.roughness)
    if config.mode is Mode.INTERSECTION:
        return RuleFusion(Intersection(config.fusion.criterion))
    if config.mode is Mode.AVERAGE:
        return RuleFusion(Average(config.fusion.weight, config.fusion.geodesic))
    return SlamAlone()


def _start(
    vslam: VSlam, frame: Frame, odometry: VoEstimate, pose: GaussianPose, sequence: Sequence, config: Config
) -> SlamEstimate | None:
    """Visual SLAM begins where odometry knows enough points to begin with, and the scale source has spoken."""
    points, seconds = odometry.points, frame.stamp - float(sequence.stamps[odometry.previous])
    if odometry.status is not Status.TRACKED or len(points) < config.slam.min_landmarks:
        return None
    if points.log_variance >= UNINFORMATIVE_VARIANCE and not config.scale.relative:
        return None
    return vslam.start(frame, pose, odometry.prev_T_cur, seconds, points)


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
        "scale": scale.metres if scale else math.nan,
        "scale_sigma": scale.metres * math.sqrt(scale.variance) if scale else math.nan,
        "parallax_px": math.nan if odometry is None else odometry.parallax,
    }
    if config.mode is Mode.VO:
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
        "interval": slam.index - slam.previous if slam else math.nan,
        "map_scale_sigma": slam.scale_sigma if slam else math.nan,
    }
