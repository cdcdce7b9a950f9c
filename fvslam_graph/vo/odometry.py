"""Visual odometry: the relative pose of every frame from matched features, without bundle adjustment."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.choices import ScaleSource
from fvslam_graph.core.config import Config, FeatureSettings
from fvslam_graph.core.gaussian_pose import GaussianPose, LogScale, ScaledPose, square_root
from fvslam_graph.core.inverse_depths import InverseDepths, MetricMap
from fvslam_graph.core.modes import outside_tracker
from fvslam_graph.core.quick import median
from fvslam_graph.core.sequence import Frame, Ground
from fvslam_graph.core.stopwatch import Stopwatch
from fvslam_graph.core.tracks import FeatureTracker, Tracks
from fvslam_graph.core.trajectory import Status
from fvslam_graph.core.vo_estimate import ScaleStep, VoEstimate
from fvslam_graph.features.detection import BORDER, detect
from fvslam_graph.features.klt import KltTracker
from fvslam_graph.features.ncc import NccMatcher
from fvslam_graph.features.texture import Texture
from fvslam_graph.vo.absolute_pose import estimate_absolute_pose, refine_absolute_pose, with_known_depths
from fvslam_graph.vo.deformation import undeformed
from fvslam_graph.vo.depth import triangulate, typical_depth
from fvslam_graph.vo.epipolar import MatchedRays, rays
from fvslam_graph.vo.ground_plane import GroundAligner
from fvslam_graph.vo.keyframe_motion import KeyframeMotion, relative_variance, standing, turning
from fvslam_graph.vo.lost_keyframes import LostKeyframe, LostKeyframes
from fvslam_graph.vo.metric_pose import metric_jacobian, metric_pose
from fvslam_graph.vo.motion_model import ConstantVelocity
from fvslam_graph.vo.plausibility import MotionGate
from fvslam_graph.vo.relative_pose import TwoViews, estimate_relative_pose
from fvslam_graph.vo.rotation import fit_rotation
from fvslam_graph.vo.scale import MetricScale

MIN_TRACK_RATIO = 2  # times the inliers needed: fewer tracks, and none is left apart
SHARE_AFTER_A_GAP = 0.7  # of the tracks that a motion explains at least: over a gap, half agree by chance now and then
MAX_FAILURES = 3  # textured images in a row that do not fit the keyframe before it is given up
GUESS = 1.0  # variance of the logarithm of a distance that is only guessed
CARRIED = 0.25  # likewise, up to which the speed carries a scale over images without a map: within a factor of 1.6


def _tracker(settings: FeatureSettings) -> FeatureTracker:
    """What the settings say."""
    if (outside := outside_tracker(settings.association)) is not None:
        made: FeatureTracker = outside.make(settings)
        return made
    return KltTracker(settings) if settings.association == "klt" else NccMatcher(settings)


class VisualOdometry:
    """Monocular visual odometry against a keyframe.

    The keyframe is the previous frame as long as the camera moves enough from frame to frame; a slower camera keeps
    it until the parallax tells a direction of travel, so that standing still and creeping do not drift.

    Args:
        camera: Of the rectified images.
        config: Settings.
        ground: What is known of the ground plane; the scale source `plane` needs it.
        true_baseline: Distance in metres between two frames by index, for the scale source `oracle`.
        tracker: Finds points again; by default what the settings say.
    """

    def __init__(
        self,
        camera: Camera,
        config: Config,
        ground: Ground | None = None,
        true_baseline: Callable[[int, int], float] | None = None,
        tracker: FeatureTracker | None = None,
    ) -> None:
        self.camera = camera
        self.settings = config.vo
        self._rng = np.random.default_rng(config.seed)
        self._features = config.features
        self._tracker = tracker or _tracker(config.features)
        self._down = None if ground is None else ground.normal
        aligner = None
        if config.scale.source is ScaleSource.PLANE and ground is not None:
            aligner = GroundAligner(camera, ground.normal, ground.normal_sigma, config.scale.ground)
        self._scale = MetricScale(config.scale, aligner, true_baseline)
        self._relative = config.scale.relative
        self._scale_known: bool | None = None  # None before the first map
        self._motion_model = ConstantVelocity(config.vo)
        self._gate = MotionGate()
        self._stopwatch = Stopwatch()

        self._keyframe: Frame | None = None
        self._points = 0  # how many the keyframe has
        self._map = MetricMap.empty()  # of the keyframe
        self._map_is_weak = True  # a plane seen with little parallax has two solutions: the map may be of the wrong one
        self._keyframe_T_last = GaussianPose.identity()  # where the last usable image was taken, and its time
        self._last_stamp = math.nan
        self._first = 0  # index of the first frame
        self._seen = Tracks.none()  # where the points were when the camera last moved
        self._lost = LostKeyframes()
        self._failures = 0  # usable images in a row that did not fit the keyframe
        self._coasted = 0  # images since the last one whose motion was believed
        self._excluded = np.empty(0, np.int64)  # tracks not to be used for the motion

    def step(self, frame: Frame, excluded: NDArray[np.int64] | None = None) -> VoEstimate:
        """Estimate the motion of the next frame; frames come in the order of their stamps.

        Args:
            frame: The next frame.
            excluded: Tracks that are followed, but not used for the motion, as long as there are enough others.
        """
        self._excluded = np.empty(0, np.int64) if excluded is None else excluded
        self._stopwatch = Stopwatch()
        if math.isnan(self._last_stamp):
            self._last_stamp, self._first = frame.stamp, frame.index
        if frame.image is None:
            return self._coast(frame, Status.SKIPPED)
        if self._keyframe is None:
            return self._restart(self._coast(frame, Status.STATIC), frame)

        if (found := self._found_again(frame)) is not None:
            return found
        with self._stopwatch.stage("association"):
            tracks = self._tracker.track(frame.image)
        if len(tracks) < self.settings.min_inliers:
            return self._handle_lost(frame)
        with self._stopwatch.stage("pose"):
            shaken = self._static_rotation(tracks)
        standing = None if shaken is None else self._static(tracks, shaken)
        measured = standing or self._measure(frame, tracks)
        if measured is None:
            return self._handle_lost(frame)
        motion = self._gated(frame, measured)
        if motion is None:
            return replace(self._coast(frame, Status.COASTED), found=len(tracks), parallax=measured.parallax)
        estimate = self._accept(frame, motion) if standing is None else self._accept_static(frame, motion)
        estimate = replace(estimate, found=len(tracks), parallax=motion.parallax)

        far = motion.scale is not None and motion.parallax > self.settings.keyframe_parallax
        self._map_is_weak &= not far
        if standing is None and (far or self._is_worn_out(motion.tracks)):
            self._set_keyframe(frame, motion.tracks, estimate.map)
        elif motion.scale is not None:
            self._map = motion.map  # in whose scale motions from this keyframe go on
        return estimate

    def recalibrate(self, frame: Frame, estimate: VoEstimate) -> None:
        """Go on with images that are rectified otherwise.

        Args:
            frame: The newest frame with its image as it is rectified from now on.
            estimate: Its estimate, with the tracks where they are in that image.
        """
        self._lost = LostKeyframes()
        pixels, far = estimate.tracks.current, np.subtract((self.camera.width, self.camera.height), BORDER + 1)
        inside = np.all((pixels > BORDER) & (pixels < far), axis=1)
        self._set_keyframe(frame, estimate.tracks[inside], estimate.map)

    def _measure(self, frame: Frame, tracks: Tracks) -> KeyframeMotion | None:
        """The motion that the image shows, and how much parallax it has; None where nothing fits."""
        with self._stopwatch.stage("pose"):
            rotation, unexplained = fit_rotation(
                rays(self.camera, tracks.keyframe), rays(self.camera, tracks.current), self.camera.fx
            )
            parallax = median(unexplained)
        motion = self._estimate_motion(frame, tracks, rotation, parallax)
        if motion is None or (self._coasted and len(motion.tracks) < SHARE_AFTER_A_GAP * len(tracks)):
            return None
        return replace(motion, parallax=parallax)

    def _estimate_motion(
        self, frame: Frame, tracks: Tracks, rotation: gtsam.Rot3, parallax: float
    ) -> KeyframeMotion | None:
        """Two views where they tell most, else the map, else what is left; None where nothing fits."""
        far, some = parallax > self.settings.keyframe_parallax, parallax > self.settings.min_parallax
        located = None if far else self._from_map(tracks, self._map)
        if located is not None and not (some and self._map_is_weak):
            return located
        if some and (motion := self._from_two_views(frame, tracks)):
            return motion if located is None else min(located, motion, key=relative_variance)
        if far:
            return self._from_map(tracks, self._map)
        return located or self._rotation_only(tracks, rotation, parallax, self._predict(frame))

    def _gated(self, frame: Frame, motion: KeyframeMotion) -> KeyframeMotion | None:
        """The motion with what may be wrong about it; None where the camera can hardly have moved so."""
        assert self._keyframe is not None
        pose = self._gate.apply(
            motion.keyframe_T_cur,
            self._predict(frame),
            frame.stamp,
            self._keyframe.stamp,
            self._motion_model.accelerations,
        )
        if pose is None:
            return None
        if self._gate.insisted and motion.scale is not None:
            # Where the motion is doubtful, so is the scale in which it was triangulated.
            known = MetricMap(motion.map.depths, motion.map.variance + GUESS)
            return replace(motion, keyframe_T_cur=pose.with_scale_variance(GUESS), map=known)
        return replace(motion, keyframe_T_cur=pose)

    def _is_worn_out(self, tracks: Tracks) -> bool:
        """Whether so few of the keyframe's points are left that another one is needed."""
        return len(tracks) < self.settings.keyframe_tracks * self._points

    def _used(self, tracks: Tracks) -> NDArray[np.bool_]:
        """(N,) which tracks tell the motion."""
        used = ~np.isin(tracks.ids, self._excluded)
        return used if used.sum() >= MIN_TRACK_RATIO * self.settings.min_inliers else np.ones(len(tracks), bool)

    def _static_rotation(self, tracks: Tracks) -> gtsam.Rot3 | None:
        """The small rotation that explains all image motion since the camera last moved; None where it moved."""
        _, before, now = np.intersect1d(self._seen.ids, tracks.ids, assume_unique=True, return_indices=True)
        if len(now) < self.settings.min_inliers:
            return None
        last, current = self._seen.current[before], tracks.current[now]
        limit = self.settings.static_rotation * self.camera.fx
        if median(np.linalg.norm(current - last, axis=1)) > limit:
            return None
        rotation, unexplained = fit_rotation(rays(self.camera, last), rays(self.camera, current), self.camera.fx)
        return rotation if median(unexplained) < self.settings.static_parallax else None

    def _static(self, tracks: Tracks, shaken: gtsam.Rot3) -> KeyframeMotion:
        """No translation, since where the camera last moved."""
        step = standing(shaken, self.settings.static_parallax / self.camera.fx, self._typical_depth())
        return KeyframeMotion(self._keyframe_T_last.compose(step), tracks, self._map)

    def _accept_static(self, frame: Frame, motion: KeyframeMotion) -> VoEstimate:
        """Take over that the camera stands; where it came to stand is kept, so that it does not drift."""
        self._motion_model.stop()
        self._last_stamp, self._failures, self._coasted = frame.stamp, 0, 0
        return replace(self._estimate(frame, motion.keyframe_T_cur, Status.STATIC), tracks=motion.tracks)

    def _from_two_views(self, frame: Frame, tracks: Tracks) -> KeyframeMotion | None:
        """Rotation and direction from the essential matrix, the baseline's length from the scale source."""
        assert self._keyframe is not None
        with self._stopwatch.stage("pose"):
            used = self._used(tracks)
            expected, trusted = self._expected(frame, tracks), None if self._map_is_weak else self._map.depths
            relative_pose = estimate_relative_pose(
                tracks[used], self.camera, self.settings, self._seed(), expected, trusted
            )
        if relative_pose is None:
            return None
        inliers, current = ~used, tracks.current.copy()
        inliers[used], current[used] = relative_pose.inliers, relative_pose.current
        relative_pose = replace(relative_pose, inliers=inliers, current=current)
        with self._stopwatch.stage("scale"):
            tracks = replace(tracks, current=current)[inliers]
            unit = self._triangulated(tracks, relative_pose.unit_pose, relative_pose.noise, relative_pose.covariance)
            # Where keyframes follow each other, depths by one motion in the next one would make its errors grow.
            lasted = self._last_stamp > self._keyframe.stamp
            if trusted is not None and lasted and not relative_pose.is_certain:
                relative_pose = with_known_depths(relative_pose, tracks, unit, trusted, self.camera) or relative_pose
                unit = self._triangulated(
                    tracks, relative_pose.unit_pose, relative_pose.noise, relative_pose.covariance
                )
            fallback = self._motion_model.distance(frame.stamp - self._keyframe.stamp)
            if fallback is None or fallback.variance > self._motion_model.log_variance + GUESS:
                fallback = self._guess(unit)
            views = TwoViews(self._keyframe, frame, relative_pose, rays(self.camera, tracks.keyframe), unit)
            scale, known = self._scale.estimate(views, self._map, fallback, self._rng)
        J_calibration = metric_jacobian(relative_pose, scale.length)[:, :5] @ relative_pose.J_calibration
        pose = metric_pose(relative_pose, scale.length)
        evidence = None if self._map_is_weak else relative_pose.evidence  # with the wrong motion, it would be wrong
        errors = square_root(relative_pose.covariance)
        return KeyframeMotion(pose, tracks, known, scale, J_calibration=J_calibration, evidence=evidence, errors=errors)

    def _expected(self, frame: Frame, tracks: Tracks) -> Iterator[gtsam.Pose3]:
        """Where the camera may be: as its motion leads there, and among the points of known depth."""
        yield self._predict(frame).mean
        if (located := self._locate(tracks, self._map)) is not None:
            yield located

    def _locate(self, tracks: Tracks, known: MetricMap) -> gtsam.Pose3 | None:
        """Roughly where the camera is among the points of known depth."""
        mine, theirs = known.depths.match(tracks.ids)
        used = self._used(tracks)[theirs]
        depths, seen = known.depths[mine[used]], tracks[theirs[used]]
        points = rays(self.camera, seen.keyframe) / depths.values[:, None]
        with self._stopwatch.stage("pose"):
            return estimate_absolute_pose(points, seen.current, self.camera, self.settings, self._seed())

    def _from_map(self, tracks: Tracks, known: MetricMap) -> KeyframeMotion | None:
        """Pose among the points of known depth: a motion too short to triangulate still moves near points."""
        if (located := self._locate(tracks, known)) is None:
            return None
        used = self._used(tracks)
        with self._stopwatch.stage("pose"):
            seen = rays(self.camera, tracks.keyframe)
            depths = known.depths.of(tracks.ids)
            matched = MatchedRays.of(self.camera, tracks)
            tracks = undeformed(tracks, matched, located.rotation(), located.translation(), depths)
            refined = refine_absolute_pose(located, seen[used], tracks[used], depths[used], self.camera)
        if refined is None or refined.agree.sum() < self.settings.min_inliers:
            return None
        kept = ~used
        kept[used] = refined.agree
        tracks = tracks[kept]
        errors = None
        if self._is_worn_out(tracks):  # what is left of the keyframe is triangulated while it can be
            errors = square_root(refined.direction_covariance)
            new = tracks[~np.isin(tracks.ids, known.depths.ids)]
            found = self._triangulated(new, refined.pose.mean, refined.noise, refined.direction_covariance)
            known = MetricMap(known.depths.fused(found[found.values > 0]), known.variance)
        # The map's scale is uncertain, and the distance travelled in it likewise.
        pose = refined.pose.with_scale_variance(known.variance)
        return KeyframeMotion(pose, tracks, known, J_calibration=refined.J_calibration, errors=errors)

    def _triangulated(
        self, tracks: Tracks, keyframe_T_cur: gtsam.Pose3, noise: float, covariance: NDArray[np.float64]
    ) -> InverseDepths:
        """Inverse depths of tracks by a motion, with the covariance of its rotation and direction."""
        matched, motion = MatchedRays.of(self.camera, tracks), keyframe_T_cur
        return triangulate(tracks.ids, matched, motion.rotation(), motion.translation(), noise, covariance)

    def _rotation_only(
        self, tracks: Tracks, rotation: gtsam.Rot3, parallax: float, expected: GaussianPose
    ) -> KeyframeMotion:
        """Rotation alone, and no translation but what may hide in the parallax, and what the motion model expects."""
        hidden = max(parallax, self.settings.static_parallax) / self.camera.fx
        return KeyframeMotion(turning(rotation, hidden, self._typical_depth(), expected), tracks, self._map)

    def _accept(self, frame: Frame, motion: KeyframeMotion) -> VoEstimate:
        """Take over a measured motion."""
        assert self._keyframe is not None
        # The mean since the keyframe: a difference of two poses that are near each other would be mostly noise.
        seconds = frame.stamp - self._keyframe.stamp
        passed = frame.stamp - self._last_stamp
        self._motion_model.observe(motion.keyframe_T_cur.mean, seconds, motion.map.variance, passed)
        self._keyframe_T_last, self._last_stamp = motion.keyframe_T_cur, frame.stamp
        self._seen, self._failures, self._coasted = motion.tracks, 0, 0
        if motion.scale is not None:
            self._scale_known = self._keeps_scale(motion.scale)
        estimate = self._estimate(frame, motion.keyframe_T_cur, Status.TRACKED)
        mine, theirs = motion.map.depths.match(motion.tracks.ids)
        seen = rays(self.camera, motion.tracks.keyframe[theirs])
        depths = motion.map.depths[mine].seen_from(seen, motion.keyframe_T_cur.mean, motion.errors)
        here = MetricMap(depths, motion.map.variance)
        return replace(
            estimate,
            tracks=motion.tracks,
            scale=motion.scale,
            map=here,
            J_calibration=motion.J_calibration,
            evidence=motion.evidence,
        )

    def _keeps_scale(self, scale: ScaleStep) -> bool:
        """Whether lengths are in the scale of the run from here on.

        A measurement tells it, the map carries it, and over a map that was lost, the speed may; a guess does not. The
        first scale of a run that is relative is a convention.
        """
        if scale.measured is not None:
            return not self._gate.insisted
        if self._scale_known is None:
            return self._relative
        carried = len(self._map) > 0 or scale.predicted.variance < CARRIED
        return self._scale_known and carried and not self._gate.insisted

    def _handle_lost(self, frame: Frame) -> VoEstimate:
        """The image does not fit the keyframe: a bad image is passed over, a changed scene becomes the keyframe."""
        assert frame.image is not None
        texture = Texture.of(frame.image, self._features.octave)
        if len(detect(texture, self._features)) < self.settings.min_inliers:
            return self._coast(frame, Status.COASTED)
        self._failures += 1
        patient = self._failures < MAX_FAILURES and self._points >= self.settings.min_inliers
        estimate = self._coast(frame, Status.COASTED if patient else Status.REINITIALISED)
        estimate = replace(estimate, prev_T_cur=estimate.prev_T_cur.after_loss(self._typical_depth()))
        if patient:
            return estimate
        if self._keyframe is not None and len(self._map) >= self.settings.min_inliers:
            tracker = copy(self._tracker)
            known = self._scale_known is not False
            self._lost.add(LostKeyframe(self._keyframe, self._map, tracker, self._last_stamp, known))
        return replace(self._restart(estimate, frame), awaited=self._lost.indices)

    def _found_again(self, frame: Frame) -> VoEstimate | None:
        """The motion from a keyframe that was lost, where this image fits it."""
        for keyframe in self._lost.remembered(frame.stamp):
            motion = self._return_to(keyframe, frame)
            if motion is not None:
                self._lost = LostKeyframes()
                self._keyframe, self._last_stamp = keyframe.frame, keyframe.stamp
                self._scale_known = keyframe.scale_known
                estimate = self._accept(frame, motion)
                self._set_keyframe(frame, motion.tracks, estimate.map)
                return estimate
        return None

    def _return_to(self, keyframe: LostKeyframe, frame: Frame) -> KeyframeMotion | None:
        """The motion from another keyframe, if enough of its points are found, and most of these agree."""
        assert frame.image is not None
        with self._stopwatch.stage("association"):
            tracks = keyframe.tracker.track(frame.image)
        if len(tracks) < MIN_TRACK_RATIO * self.settings.min_inliers:
            return None
        motion = self._from_map(tracks, keyframe.map)
        return motion if motion and len(motion.tracks) >= self.settings.keyframe_tracks * len(tracks) else None

    def _restart(self, estimate: VoEstimate, frame: Frame) -> VoEstimate:
        """Begin anew at this frame, whose pose is that of the estimate."""
        self._set_keyframe(frame, Tracks.none(), MetricMap.empty())
        self._map_is_weak = True
        self._motion_model.coast(frame.stamp - self._last_stamp)
        self._last_stamp = frame.stamp
        return estimate

    def _coast(self, frame: Frame, status: Status) -> VoEstimate:
        """The motion model carries on from the last usable image, in the scale that its velocity has."""
        self._coasted += 1
        step, variance = self._motion_model.predict(frame.stamp - self._last_stamp), self._motion_model.log_variance
        # The last motion has this scale as far as its covariance holds it.
        last = ScaledPose.of(self._keyframe_T_last, variance).replaced(self._keyframe_T_last)
        pose = last.compose(ScaledPose.of(step.with_scale_variance(variance), variance)).total
        return self._estimate(frame, pose, status)

    def _predict(self, frame: Frame) -> GaussianPose:
        """keyframe_T_cur as the motion model has it."""
        return self._keyframe_T_last.compose(self._motion_model.predict(frame.stamp - self._last_stamp))

    def _set_keyframe(self, frame: Frame, kept: Tracks, known: MetricMap) -> None:
        assert frame.image is not None
        with self._stopwatch.stage("detection"):
            self._seen = self._tracker.set_keyframe(frame.image, kept)
        self._keyframe, self._map, self._points = frame, known, len(self._seen)
        self._keyframe_T_last = GaussianPose.identity()
        self._failures = self._coasted = 0
        self._gate.forget()

    def _guess(self, unit: InverseDepths) -> LogScale:
        """The scale at which triangulated points are as far away as things usually are."""
        seen = unit.values[unit.values > 0]
        return LogScale(math.log(self._typical_depth() * median(seen)) if len(seen) else 0.0, GUESS)

    def _typical_depth(self) -> float:
        """Metres to what is seen."""
        height = math.nan if self._keyframe is None else self._keyframe.height
        return typical_depth(self._map.depths, rays(self.camera, self._seen.current), self._down, height)

    def _seed(self) -> int:
        return int(self._rng.integers(2**31))

    def _estimate(self, frame: Frame, keyframe_T_cur: GaussianPose, status: Status) -> VoEstimate:
        keyframe = self._first if self._keyframe is None else self._keyframe.index
        return VoEstimate(
            frame.index,
            keyframe,
            keyframe_T_cur,
            status,
            scale_known=self._scale_known is not False,
            awaited=self._lost.indices,
            times=self._stopwatch.times,
        )
