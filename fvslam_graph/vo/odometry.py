"""Visual odometry: the relative pose of every frame from matched features, without bundle adjustment."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.choices import ScaleSource
from fvslam_graph.core.config import Config, FeatureSettings
from fvslam_graph.core.gaussian_pose import GaussianPose, ScaledPose
from fvslam_graph.core.inverse_depths import MetricMap
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
from fvslam_graph.vo.depth import typical_depth
from fvslam_graph.vo.fixed_points import FixedPoints
from fvslam_graph.vo.ground_plane import GroundAligner
from fvslam_graph.vo.keyframe_motion import KeyframeMotion, are_apart, standing, with_planar_ambiguity
from fvslam_graph.vo.lost_keyframes import LostKeyframe, LostKeyframes
from fvslam_graph.vo.motion_measurement import GUESS, Keyframe, MotionMeasurement, View
from fvslam_graph.vo.motion_model import ConstantVelocity
from fvslam_graph.vo.plausibility import MotionGate
from fvslam_graph.vo.rotation import fit_rotation, near_parallax
from fvslam_graph.vo.scale import MetricScale

MIN_TRACK_RATIO = 2  # times the inliers needed: fewer tracks, and none is left apart
SHARE_AFTER_A_GAP = 0.7  # of the tracks that a motion explains at least: over a gap, half agree by chance now and then
CLEAR_PARALLAX = 20.0  # deviations of a track's noise; with more, the first map is right
MAX_FAILURES = 3  # textured images in a row that do not fit the keyframe before it is given up
CARRIED = 0.25  # variance of a logarithm, up to which the speed carries a scale without a map: within a factor of 1.6


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
        self._features = config.features
        self._tracker = tracker or _tracker(config.features)
        self._down = None if ground is None else ground.normal
        aligner, common_sigma = None, 0.0
        if config.scale.source is ScaleSource.PLANE and ground is not None:
            aligner = GroundAligner(camera, ground.normal, ground.normal_sigma, config.scale.ground)
            common_sigma = ground.common_sigma
        self._motion_model = ConstantVelocity(config.vo)
        self._scale = MetricScale(config.scale, aligner, true_baseline, common_sigma)
        rng = np.random.default_rng(config.seed)
        self._measurement = MotionMeasurement(camera, config.vo, self._scale, self._motion_model, rng, self._down)
        self._relative = config.scale.relative
        self._scale_known: bool | None = None  # None before the first map
        self._gate = MotionGate()
        self._stopwatch = Stopwatch()

        self._keyframe: Keyframe | None = None
        self._keyframe_T_last = GaussianPose.identity()  # where the last usable image was taken, and its time
        self._last_stamp = math.nan
        self._first = 0  # index of the first frame
        self._seen = Tracks.none()  # where the points were when the camera last moved
        self._fixed = FixedPoints()
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
            tracks = self._fixed.without(self._tracker.track(frame.image))
        if len(tracks) < self.settings.min_inliers:
            return self._handle_lost(frame)
        view = self._view(self._keyframe, frame, tracks)
        standing = self._static(view)
        measured = standing or self._measure(view)
        if measured is None:
            return self._handle_lost(frame)
        motion = self._gated(frame, measured)
        if motion is None:
            return replace(self._coast(frame, Status.COASTED), found=len(tracks), parallax=measured.parallax)
        accept = self._accept if standing is None else self._accept_static
        estimate = replace(accept(frame, motion), found=len(tracks), parallax=motion.parallax)
        return self._with_keyframe_updated(frame, motion, estimate)

    def _with_keyframe_updated(self, frame: Frame, motion: KeyframeMotion, estimate: VoEstimate) -> VoEstimate:
        """Make the image the keyframe, or take over what was learnt of the old one."""
        assert self._keyframe is not None
        two_views = motion.scale is not None
        far = two_views and motion.parallax > self.settings.keyframe_parallax
        clear = two_views and motion.near_parallax > CLEAR_PARALLAX * motion.noise
        strong = two_views and motion.near_parallax > self.settings.keyframe_parallax
        weak = self._keyframe.map_is_weak and not strong
        worn_out = self._measurement.is_worn_out(self._keyframe, motion.tracks)
        if estimate.status is not Status.STATIC and (far or worn_out):
            self._set_keyframe(frame, motion.tracks, estimate.map, weak)
        else:  # motions from this keyframe go on in the scale of what was triangulated
            known = self._keyframe.map if motion.scale is None else motion.map
            guessed = self._keyframe.scale_is_guessed and not clear
            self._keyframe = replace(self._keyframe, map=known, map_is_weak=weak, scale_is_guessed=guessed)
        return replace(estimate, map_is_doubtful=weak and not clear)

    def correct_scale(self, calibration: NDArray[np.float64]) -> None:
        """Carry the scale as it would be by another calibration of the images.

        What the source measures stays as it is: a step in it would bend the path.

        Args:
            calibration: (2,) what is to be added to the logarithm of the focal length and to k1.
        """
        self._scale.calibration = calibration

    def recalibrate(self, frame: Frame, estimate: VoEstimate) -> None:
        """Go on with images that are rectified otherwise.

        Args:
            frame: The newest frame with its image as it is rectified from now on.
            estimate: Its estimate, with the tracks where they are in that image.
        """
        assert self._keyframe is not None
        self._lost, self._fixed = LostKeyframes(), FixedPoints()
        pixels, far = estimate.tracks.current, np.subtract((self.camera.width, self.camera.height), BORDER + 1)
        inside = np.all((pixels > BORDER) & (pixels < far), axis=1)
        self._set_keyframe(frame, estimate.tracks[inside], estimate.map, self._keyframe.map_is_weak)

    def _measure(self, view: View) -> KeyframeMotion | None:
        """The motion that the image shows, and how much parallax it has; None where nothing fits."""
        motion = self._measurement.measure(view)
        if motion is None or (self._coasted and len(motion.tracks) < SHARE_AFTER_A_GAP * len(view.tracks)):
            return None
        return motion

    def _view(self, keyframe: Keyframe, frame: Frame, tracks: Tracks) -> View:
        """An image that shows these points of the keyframe."""
        used = np.ones(len(tracks), bool)
        if len(self._excluded):
            used = ~np.isin(tracks.ids, self._excluded)
        if used.sum() < MIN_TRACK_RATIO * self.settings.min_inliers:
            used[:] = True
        first = self._last_stamp <= keyframe.frame.stamp
        expected, distance = self._predict(frame), self._typical_depth(keyframe)
        return View(keyframe, frame, tracks, used, expected, distance, first, self._stopwatch)

    def _gated(self, frame: Frame, motion: KeyframeMotion) -> KeyframeMotion | None:
        """The motion with what may be wrong about it; None where the camera can hardly have moved so."""
        assert self._keyframe is not None
        pose = self._gate.apply(
            motion.keyframe_T_cur,
            self._predict(frame),
            frame.stamp,
            self._keyframe.frame.stamp,
            self._motion_model.accelerations,
            motion.map.variance,
        )
        if pose is None:
            return None
        if self._gate.insisted and motion.scale is not None:
            # Where the motion is doubtful, so is the scale in which it was triangulated.
            known = MetricMap(motion.map.depths, motion.map.variance + GUESS)
            return replace(motion, keyframe_T_cur=pose.with_scale_variance(GUESS), map=known)
        return replace(motion, keyframe_T_cur=pose)

    def _static_rotation(self, tracks: Tracks) -> gtsam.Rot3 | None:
        """The small rotation that explains all image motion since the camera last moved; None where it moved."""
        _, before, now = np.intersect1d(self._seen.ids, tracks.ids, assume_unique=True, return_indices=True)
        if len(now) < self.settings.min_inliers:
            return None
        last, current = self._seen.current[before], tracks.current[now]
        limit = self.settings.static_rotation * self.camera.fx
        if median(np.hypot(*(current - last).T)) > limit:
            return None
        rotation, unexplained = fit_rotation(self.camera.rays(last), self.camera.rays(current), self.camera.fx)
        return rotation if near_parallax(unexplained) < self.settings.static_parallax else None

    def _static(self, view: View) -> KeyframeMotion | None:
        """No translation, since where the camera last moved; None where it has moved."""
        with self._stopwatch.stage("pose"):
            shaken = self._static_rotation(view.tracks)
        if shaken is None:
            return None
        step = standing(shaken, self.settings.static_parallax / self.camera.fx, view.distance)
        here = KeyframeMotion(self._keyframe_T_last.compose(step), view.tracks, view.keyframe.map)
        # Few points may be near enough to tell that it moves, and if their depths are known, they do.
        located = None if view.keyframe.map_is_weak else self._measurement.from_map(view)
        return here if located is None or not are_apart(here, located) else None

    def _accept_static(self, frame: Frame, motion: KeyframeMotion) -> VoEstimate:
        """Take over that the camera stands; where it came to stand is kept, so that it does not drift."""
        self._motion_model.stop()
        self._last_stamp, self._failures, self._coasted = frame.stamp, 0, 0
        return replace(self._estimate(frame, motion.keyframe_T_cur, Status.STATIC), tracks=motion.tracks)

    def _accept(self, frame: Frame, motion: KeyframeMotion) -> VoEstimate:
        """Take over a measured motion."""
        assert self._keyframe is not None
        # The mean since the keyframe: a difference of two poses that are near each other would be mostly noise.
        seconds = frame.stamp - self._keyframe.frame.stamp
        passed = frame.stamp - self._last_stamp
        measured = motion.keyframe_T_cur
        if self._keyframe.map_is_weak:
            measured = with_planar_ambiguity(measured, self._typical_depth(self._keyframe))
        self._motion_model.observe(measured, seconds, motion.map.variance, passed)
        self._keyframe_T_last, self._last_stamp = motion.keyframe_T_cur, frame.stamp
        self._seen, self._failures, self._coasted = motion.tracks, 0, 0
        if motion.scale is not None:
            self._scale_known = self._keeps_scale(self._keyframe.map, motion.scale)
        estimate = self._estimate(frame, motion.keyframe_T_cur, Status.TRACKED)
        mine, theirs = motion.map.depths.match(motion.tracks.ids)
        seen = self.camera.rays(motion.tracks.keyframe[theirs])
        depths = motion.map.depths[mine].seen_from(
            seen, motion.keyframe_T_cur.mean, motion.errors, motion.J_calibration
        )
        here = MetricMap(depths, motion.map.variance)
        return replace(
            estimate,
            tracks=motion.tracks,
            scale=motion.scale,
            map=here,
            J_calibration=motion.J_calibration,
            evidence=motion.evidence,
        )

    def _keeps_scale(self, known: MetricMap, scale: ScaleStep) -> bool:
        """Whether lengths are in the scale of the run from here on.

        A measurement tells it, the map carries it, and over a map that was lost, the speed may; a guess does not. The
        first scale of a run that is relative is a convention.
        """
        if scale.measured is not None:
            return not self._gate.insisted
        if self._scale_known is None:
            return self._relative
        carried = len(known) > 0 or scale.predicted.variance < CARRIED
        return self._scale_known and carried and not self._gate.insisted

    def _handle_lost(self, frame: Frame) -> VoEstimate:
        """The image does not fit the keyframe: a bad image is passed over, a changed scene becomes the keyframe."""
        assert frame.image is not None and self._keyframe is not None
        texture = Texture.of(frame.image, self._features.octave)
        if len(detect(texture, self._features)) < self.settings.min_inliers:
            return self._coast(frame, Status.COASTED)
        self._failures += 1
        patient = self._failures < MAX_FAILURES and self._keyframe.points >= self.settings.min_inliers
        estimate = self._coast(frame, Status.COASTED if patient else Status.REINITIALISED)
        estimate = replace(estimate, prev_T_cur=estimate.prev_T_cur.after_loss(self._typical_depth(self._keyframe)))
        if patient:
            return estimate
        if len(self._keyframe.map) >= self.settings.min_inliers:
            tracker, known = copy(self._tracker), self._scale_known is not False
            self._lost.add(LostKeyframe(self._keyframe, tracker, self._fixed, self._last_stamp, known))
            self._fixed = FixedPoints()
        return replace(self._restart(estimate, frame), awaited=self._lost.indices)

    def _found_again(self, frame: Frame) -> VoEstimate | None:
        """The motion from a keyframe that was lost, where this image fits it."""
        for lost in self._lost.remembered(frame.stamp):
            motion = self._return_to(lost, frame)
            if motion is not None:
                self._lost, self._fixed = LostKeyframes(), lost.fixed
                self._keyframe, self._last_stamp, self._scale_known = lost.keyframe, lost.stamp, lost.scale_known
                estimate = self._accept(frame, motion)
                self._set_keyframe(frame, motion.tracks, estimate.map, lost.keyframe.map_is_weak)
                return replace(estimate, map_is_doubtful=lost.keyframe.map_is_weak)
        return None

    def _return_to(self, lost: LostKeyframe, frame: Frame) -> KeyframeMotion | None:
        """The motion from another keyframe, if enough of its points are found, and most of these agree."""
        assert frame.image is not None
        with self._stopwatch.stage("association"):
            tracks = lost.fixed.without(lost.tracker.track(frame.image))
        if len(tracks) < MIN_TRACK_RATIO * self.settings.min_inliers:
            return None
        motion = self._measurement.from_map(self._view(lost.keyframe, frame, tracks))
        return motion if motion and len(motion.tracks) >= self.settings.keyframe_tracks * len(tracks) else None

    def _restart(self, estimate: VoEstimate, frame: Frame) -> VoEstimate:
        """Begin anew at this frame, whose pose is that of the estimate."""
        self._set_keyframe(frame, Tracks.none(), MetricMap.empty(), weak=True)
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

    def _set_keyframe(self, frame: Frame, kept: Tracks, known: MetricMap, weak: bool) -> None:
        assert frame.image is not None
        with self._stopwatch.stage("detection"):
            self._seen = self._tracker.set_keyframe(frame.image, kept.joined(self._fixed.tracks))
        points, guessed = len(self._seen) - len(self._fixed.tracks), not len(known) and not self._relative
        self._keyframe = Keyframe(frame, known, points, weak, guessed)
        self._keyframe_T_last = GaussianPose.identity()
        self._failures = self._coasted = 0
        self._gate.forget()

    def _typical_depth(self, keyframe: Keyframe) -> float:
        """Metres to what is seen."""
        seen = self.camera.rays(self._seen.current)
        return typical_depth(keyframe.map.depths, seen, self._down, keyframe.frame.height)

    def _estimate(self, frame: Frame, keyframe_T_cur: GaussianPose, status: Status) -> VoEstimate:
        keyframe = self._first if self._keyframe is None else self._keyframe.frame.index
        return VoEstimate(
            frame.index,
            keyframe,
            keyframe_T_cur,
            status,
            scale_known=self._scale_known is not False,
            awaited=self._lost.indices,
            times=self._stopwatch.times,
        )
