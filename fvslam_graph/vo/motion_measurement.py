"""What an image shows of the motion since the keyframe: by two views, among points of known depth, or a rotation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import VoSettings
from fvslam_graph.core.gaussian_pose import GaussianPose, LogScale, square_root
from fvslam_graph.core.inverse_depths import InverseDepths, MetricMap
from fvslam_graph.core.quick import median
from fvslam_graph.core.sequence import Frame
from fvslam_graph.core.stopwatch import Stopwatch
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.vo.absolute_pose import (
    AbsolutePose,
    estimate_absolute_pose,
    refine_absolute_pose,
    with_known_depths,
)
from fvslam_graph.vo.deformation import undeformed
from fvslam_graph.vo.depth import triangulate
from fvslam_graph.vo.epipolar import MatchedRays
from fvslam_graph.vo.keyframe_motion import KeyframeMotion, relative_variance, turning
from fvslam_graph.vo.metric_pose import metric_jacobian, metric_pose
from fvslam_graph.vo.motion_model import ConstantVelocity
from fvslam_graph.vo.relative_pose import RelativePose, TwoViews, estimate_relative_pose
from fvslam_graph.vo.rotation import fit_rotation, near_parallax
from fvslam_graph.vo.scale import MetricScale

GUESS = 1.0  # variance of the logarithm of a distance that is only guessed


@dataclass(frozen=True)
class Keyframe:
    """What motions are measured against.

    Attributes:
        frame: Its image.
        map: What is known of the depths of its points.
        points: How many it has.
        map_is_weak: A plane seen with little parallax has two solutions: the map may be of the wrong one.
        scale_is_guessed: Nothing was known of its points before, and no motion was clear yet: unless something measured
            it, the scale of its map is a guess by hardly any parallax. Where nothing ever tells metres, it is no guess
            but a convention.
    """

    frame: Frame
    map: MetricMap
    points: int
    map_is_weak: bool
    scale_is_guessed: bool


@dataclass(frozen=True)
class View:
    """An image that shows points of the keyframe, and what is known of it beforehand.

    Attributes:
        keyframe: This.
        frame: The image.
        tracks: N points.
        used: (N,) which of them tell the motion.
        expected: keyframe_T_cur by the motion model.
        distance: Metres to what is seen.
        first: Whether it is the first since the keyframe.
        stopwatch: Of its stages.
    """

    keyframe: Keyframe
    frame: Frame
    tracks: Tracks
    used: NDArray[np.bool_]
    expected: GaussianPose
    distance: float
    first: bool
    stopwatch: Stopwatch


class MotionMeasurement:
    """Measures the motion of images against their keyframe.

    Args:
        camera: Of the rectified images.
        settings: Of odometry.
        scale: Tells lengths.
        motion_model: Tells them where nothing else does.
        rng: Draws the samples.
        down: (3,) unit vector to the ground in the camera; None where there is none.
    """

    def __init__(
        self,
        camera: Camera,
        settings: VoSettings,
        scale: MetricScale,
        motion_model: ConstantVelocity,
        rng: np.random.Generator,
        down: NDArray[np.float64] | None = None,
    ) -> None:
        self._camera, self._settings, self._down = camera, settings, down
        self._scale, self._motion_model, self._rng = scale, motion_model, rng

    def measure(self, view: View) -> KeyframeMotion | None:
        """Two views where they tell most, else the map, else what is left; None where nothing fits."""
        tracks = view.tracks
        with view.stopwatch.stage("pose"):
            rotation, unexplained = fit_rotation(
                self._camera.rays(tracks.keyframe), self._camera.rays(tracks.current), self._camera.fx
            )
        motion = self._by_parallax(view, rotation, unexplained)
        return motion and replace(motion, parallax=median(unexplained), near_parallax=near_parallax(unexplained))

    def from_map(self, view: View) -> KeyframeMotion | None:
        """Pose among the points of known depth: a motion too short to triangulate still moves near points."""
        known = view.keyframe.map
        if (located := self._locate(view)) is None:
            return None
        with view.stopwatch.stage("pose"):
            refined, tracks = self._refined(located, view)
            # Where most points are on the horizon, they agree whatever the translation is: few samples tell it.
            mine, theirs = known.depths.match(view.tracks.ids[view.used])
            telling = theirs[known.depths.telling[mine]]
            if refined is not None and refined.agree[telling].sum() < len(telling) / 2:
                other, others = self._refined(view.expected.mean, view)
                if other is not None and other.agree[telling].sum() > len(telling) / 2:
                    refined, tracks = other, others
        if refined is None or refined.agree.sum() < self._settings.min_inliers:
            return None
        kept = ~view.used
        kept[view.used] = refined.agree
        tracks = tracks[kept]
        errors = None
        if self.is_worn_out(view.keyframe, tracks):  # what is left of the keyframe is triangulated while it can be
            errors = square_root(refined.direction_covariance)
            new = tracks[~np.isin(tracks.ids, known.depths.ids)]
            found = self._triangulated(
                new,
                refined.pose.mean,
                refined.noise,
                refined.direction_covariance,
                refined.J_direction @ refined.J_calibration,
            )
            known = MetricMap(known.depths.fused(found[found.values > 0]), known.variance)
        # The map's scale is uncertain, and the distance travelled in it likewise.
        pose = refined.pose.with_scale_variance(known.variance)
        return KeyframeMotion(pose, tracks, known, J_calibration=refined.J_calibration, errors=errors)

    def _refined(self, start: gtsam.Pose3, view: View) -> tuple[AbsolutePose | None, Tracks]:
        """The pose near another by all tracks, and these without what the change of view makes them err."""
        tracks, used, depths = view.tracks, view.used, view.keyframe.map.depths.of(view.tracks.ids)
        matched = MatchedRays.of(self._camera, tracks)
        tracks = undeformed(tracks, matched, start.rotation(), start.translation(), depths)
        seen = self._camera.rays(tracks.keyframe[used])
        return refine_absolute_pose(start, seen, tracks[used], depths[used], self._camera), tracks

    def is_worn_out(self, keyframe: Keyframe, tracks: Tracks) -> bool:
        """Whether so few of the keyframe's points are left, or of those that tell how far, that another is needed."""
        share, depths = self._settings.keyframe_tracks, keyframe.map.depths
        if len(tracks) < share * keyframe.points:
            return True
        mine, _ = depths.match(tracks.ids)
        telling = depths.telling
        return bool(telling[mine].sum() < share * telling.sum())

    def _by_parallax(self, view: View, rotation: gtsam.Rot3, unexplained: NDArray[np.float64]) -> KeyframeMotion | None:
        parallax = near_parallax(unexplained)
        far, some = median(unexplained) > self._settings.keyframe_parallax, parallax > self._settings.min_parallax
        located = None if far else self.from_map(view)
        if located is not None and not (some and view.keyframe.map_is_weak):
            return located
        if some and (motion := self._from_two_views(view)):
            return motion if located is None else min(located, motion, key=relative_variance)
        if far:
            return self.from_map(view)
        return located or self._rotation_only(view, rotation, parallax)

    def _from_two_views(self, view: View) -> KeyframeMotion | None:
        """Rotation and direction from the essential matrix, the baseline's length from the scale source."""
        keyframe, tracks, used = view.keyframe, view.tracks, view.used
        trusted = None if keyframe.map_is_weak else keyframe.map.depths
        with view.stopwatch.stage("pose"):
            relative_pose = estimate_relative_pose(
                tracks[used], self._camera, self._settings, self._seed(), self._expected(view), trusted, self._down
            )
        if relative_pose is None:
            return None
        known = keyframe.map
        if relative_pose.refutes_depths:
            trusted, known = None, MetricMap.empty()
        inliers, current = ~used, tracks.current.copy()
        inliers[used], current[used] = relative_pose.inliers, relative_pose.current
        relative_pose = replace(relative_pose, inliers=inliers, current=current)
        with view.stopwatch.stage("scale"):
            tracks = replace(tracks, current=current)[inliers]
            # Where keyframes follow each other, depths by one motion in the next one would make its errors grow.
            if trusted is not None and not view.first and not relative_pose.is_certain:
                unit = self._by_two_views(tracks, relative_pose)
                relative_pose = with_known_depths(relative_pose, tracks, unit, trusted, self._camera) or relative_pose
            relative_pose = replace(relative_pose, covariance=relative_pose.covariance + relative_pose.spread)
            unit = self._by_two_views(tracks, relative_pose)
            fallback = self._motion_model.distance(view.frame.stamp - keyframe.frame.stamp)
            if keyframe.scale_is_guessed and known.variance >= GUESS:  # with more parallax, the guess is a better one
                known, fallback = MetricMap.empty(), None
            if fallback is None or fallback.variance > self._motion_model.log_variance + GUESS:
                fallback = _guess(unit, view.distance)
            views = TwoViews(keyframe.frame, view.frame, relative_pose, self._camera.rays(tracks.keyframe), unit)
            scale, known = self._scale.estimate(views, known, fallback, self._rng)
        J_calibration = metric_jacobian(relative_pose, scale.length)[:, :5] @ relative_pose.J_calibration
        pose = metric_pose(relative_pose, scale.length)
        evidence = None if keyframe.map_is_weak else relative_pose.evidence  # with the wrong motion, it would be wrong
        errors = square_root(relative_pose.covariance)
        noise = relative_pose.noise
        return KeyframeMotion(
            pose, tracks, known, scale, J_calibration=J_calibration, evidence=evidence, errors=errors, noise=noise
        )

    def _expected(self, view: View) -> Iterator[gtsam.Pose3]:
        """Where the camera may be: as its motion leads there, and among the points of known depth."""
        yield view.expected.mean
        if (located := self._locate(view)) is not None:
            yield located

    def _locate(self, view: View) -> gtsam.Pose3 | None:
        """Roughly where the camera is among the points of known depth."""
        known = view.keyframe.map
        mine, theirs = known.depths.match(view.tracks.ids)
        used = view.used[theirs]
        depths, seen = known.depths[mine[used]], view.tracks[theirs[used]]
        points = self._camera.rays(seen.keyframe) / depths.values[:, None]
        with view.stopwatch.stage("pose"):
            return estimate_absolute_pose(points, seen.current, self._camera, self._settings, self._seed())

    def _rotation_only(self, view: View, rotation: gtsam.Rot3, parallax: float) -> KeyframeMotion:
        """Rotation alone, and no translation but what may hide in the parallax, and what the motion model expects."""
        hidden = max(parallax, self._settings.static_parallax) / self._camera.fx
        return KeyframeMotion(turning(rotation, hidden, view.distance, view.expected), view.tracks, view.keyframe.map)

    def _by_two_views(self, tracks: Tracks, relative: RelativePose) -> InverseDepths:
        return self._triangulated(
            tracks, relative.unit_pose, relative.noise, relative.covariance, relative.J_calibration
        )

    def _triangulated(
        self,
        tracks: Tracks,
        keyframe_T_cur: gtsam.Pose3,
        noise: float,
        covariance: NDArray[np.float64],
        J_calibration: NDArray[np.float64],
    ) -> InverseDepths:
        """Inverse depths of tracks by a motion; covariance and Jacobian (5, 2) of its rotation and direction."""
        matched, motion = MatchedRays.of(self._camera, tracks), keyframe_T_cur
        return triangulate(
            tracks.ids, matched, motion.rotation(), motion.translation(), noise, covariance, J_calibration
        )

    def _seed(self) -> int:
        return int(self._rng.integers(2**31))


def _guess(unit: InverseDepths, distance: float) -> LogScale:
    """The scale at which triangulated points are as far away as things usually are."""
    usual = unit.usual
    return LogScale(math.log(distance * usual) if usual > 0 else 0.0, GUESS)
