"""Visual odometry: the relative pose of every frame from matched features, without bundle adjustment."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.camera import Camera
from fvslam_graph.config import Config, ScaleSource
from fvslam_graph.features.detection import detect
from fvslam_graph.features.klt import KltTracker
from fvslam_graph.features.ncc import NccMatcher
from fvslam_graph.features.tracks import Association, Tracks
from fvslam_graph.sequences.base import Frame, Ground
from fvslam_graph.stopwatch import Stopwatch
from fvslam_graph.trajectory import Status
from fvslam_graph.vo.depth import InverseDepths, triangulate
from fvslam_graph.vo.ground import GroundAligner
from fvslam_graph.vo.locate import locate
from fvslam_graph.vo.motion_model import ConstantVelocity, compose_covariance
from fvslam_graph.vo.rotation import fit_rotation
from fvslam_graph.vo.scale import LogScale, MetricScale
from fvslam_graph.vo.two_view import TwoView, estimate_two_view, rays

Covariance = NDArray[np.float64]
PATIENCE = 3  # textured images in a row that do not fit the reference before it is given up


@dataclass(frozen=True)
class VoEstimate:
    """The motion of one frame.

    Attributes:
        index: Of the frame.
        previous: Index of the frame that the motion starts from: the reference (keyframe) at that time.
        prev_T_cur: Pose of this frame in that one, metres.
        covariance: (6, 6) in the tangent of prev_T_cur: rotation, then translation.
        status: How it came about.
        tracks: Points of the reference found in this frame that agree with the motion.
        found: How many were found, agreeing or not.
        scale: Of the baseline between the two; None where none was estimated.
        parallax: Median image motion that no rotation explains, pixels; NaN where not measured.
        times: Milliseconds by stage.
    """

    index: int
    previous: int
    prev_T_cur: gtsam.Pose3
    covariance: Covariance
    status: Status
    tracks: Tracks = field(default_factory=Tracks.none)
    found: int = 0
    scale: LogScale | None = None
    parallax: float = math.nan
    times: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class _Motion:
    """A measured motion against the reference, and the depths of the reference's points as known after it."""

    ref_T_cur: gtsam.Pose3
    covariance: Covariance
    tracks: Tracks
    depths: InverseDepths
    scale: LogScale | None = None


class VisualOdometry:
    """Monocular visual odometry against a reference frame (keyframe).

    The reference is the previous frame as long as the camera moves enough from frame to frame; a slower camera keeps
    it until the parallax tells a direction of travel, so that standing still and creeping do not drift.

    Args:
        camera: Of the rectified images.
        config: Settings.
        ground: What is known of the ground plane; the scale source `plane` needs it.
        true_baseline: Distance in metres between two frames by index, for the scale source `oracle`.
    """

    def __init__(
        self,
        camera: Camera,
        config: Config,
        ground: Ground | None = None,
        true_baseline: Callable[[int, int], float] | None = None,
    ) -> None:
        self.camera = camera
        self.settings = config.vo
        self._rng = np.random.default_rng(config.seed)
        self._features = config.features
        self._association: Association = (
            KltTracker(config.features) if config.features.association == "klt" else NccMatcher(config.features)
        )
        aligner = None
        if config.scale.source is ScaleSource.PLANE and ground is not None:
            aligner = GroundAligner(camera, ground.normal, ground.normal_sigma, config.scale.ground)
        self._scale = MetricScale(config.scale, aligner, true_baseline)
        self._motion_model = ConstantVelocity(config.vo)
        self._stopwatch = Stopwatch()

        self._reference: Frame | None = None
        self._points = 0  # how many the reference has
        self._depths = InverseDepths.none()  # of these points, metres
        self._map_variance = 0.0  # of the log scale that all these depths share
        self._ref_T_last = gtsam.Pose3()  # where the last usable image was taken, its covariance and time
        self._covariance = np.zeros((6, 6))
        self._last_stamp = 0.0
        self._seen = Tracks.none()  # where the points were when the camera last moved
        self._failures = 0  # usable images in a row that did not fit the reference

    def step(self, frame: Frame) -> VoEstimate:
        """Estimate the motion of the next frame; frames come in the order of their stamps."""
        self._stopwatch = Stopwatch()
        if frame.image is None:
            return self._coast(frame, Status.SKIPPED)
        if self._reference is None:
            return self._begin(frame)

        with self._stopwatch.stage("association"):
            tracks = self._association.track(frame.image)
        if len(tracks) < self.settings.min_inliers:
            return self._lose(frame)
        with self._stopwatch.stage("pose"):
            shaken = self._stands_still(tracks)
        if shaken is not None:
            return self._stand(frame, tracks, shaken)

        with self._stopwatch.stage("pose"):
            rotation, unexplained = fit_rotation(
                rays(self.camera, tracks.reference), rays(self.camera, tracks.current), self.camera.fx
            )
            parallax = float(np.median(unexplained))
        with self._stopwatch.stage("pose"):
            if parallax > self.settings.keyframe_parallax:
                motion = self._move_by_two_views(frame, tracks)
            else:
                motion = self._move_in_map(tracks) or self._turn(tracks, rotation, parallax)
        if motion is None:
            return self._lose(frame)
        return replace(self._accept(frame, motion), found=len(tracks), parallax=parallax)

    def _begin(self, frame: Frame) -> VoEstimate:
        self._refer_to(frame, Tracks.none(), InverseDepths.none())
        self._last_stamp = frame.stamp
        return self._estimate(frame, frame.index, gtsam.Pose3(), np.zeros((6, 6)), Status.STATIC)

    def _stands_still(self, tracks: Tracks) -> gtsam.Rot3 | None:
        """The small rotation that explains all image motion since the camera last moved; None where it moved."""
        _, before, now = np.intersect1d(self._seen.ids, tracks.ids, assume_unique=True, return_indices=True)
        if len(now) < self.settings.min_inliers:
            return None
        last, current = self._seen.current[before], tracks.current[now]
        limit = self.settings.static_rotation * self.camera.fx
        if np.median(np.linalg.norm(current - last, axis=1)) > limit:
            return None
        rotation, unexplained = fit_rotation(rays(self.camera, last), rays(self.camera, current), self.camera.fx)
        return rotation if np.median(unexplained) < self.settings.static_parallax else None

    def _stand(self, frame: Frame, tracks: Tracks, shaken: gtsam.Rot3) -> VoEstimate:
        """No translation, with the uncertainty of a parallax that counts as none."""
        hidden = self.settings.static_parallax / self.camera.fx
        sigmas = np.repeat([hidden, hidden * self._typical_depth(frame)], 3)
        step = gtsam.Pose3(shaken, np.zeros(3))
        covariance = compose_covariance(self._covariance, step, np.diag(sigmas**2))
        self._motion_model.observe(gtsam.Pose3(), 1.0)
        self._last_stamp = frame.stamp
        self._failures = 0
        return self._estimate(frame, self._index(), self._ref_T_last.compose(step), covariance, Status.STATIC, tracks)

    def _move_by_two_views(self, frame: Frame, tracks: Tracks) -> _Motion | None:
        """Rotation and direction from the essential matrix, the baseline's length from the scale source."""
        assert self._reference is not None
        two_view = estimate_two_view(tracks, self.camera, self.settings, self._seed())
        if two_view is None:
            return None
        tracks = tracks[two_view.inliers]
        previous, current = rays(self.camera, tracks.reference), rays(self.camera, tracks.current)
        unit = triangulate(tracks.ids, previous, current, two_view.rotation, two_view.direction, self.camera.fx)
        with self._stopwatch.stage("scale"):
            known = self._depths
            predicted = self._scale.from_map(unit, known, self._map_variance)
            prior = predicted or self._motion_model.distance(frame.stamp - self._reference.stamp)
            scale = self._scale.estimate(self._reference, frame, two_view, previous, unit, prior, self._rng)
        if predicted is not None:  # what the scale source says of this baseline holds for the whole map
            known = known.scaled(scale.metres / predicted.metres)
        metric = unit.scaled(scale.metres)
        depths = known.fused(metric[metric.values > 0])
        ref_T_cur = gtsam.Pose3(two_view.rotation, scale.metres * two_view.direction)
        return _Motion(ref_T_cur, _metric_covariance(two_view, scale), tracks, depths, scale)

    def _move_in_map(self, tracks: Tracks) -> _Motion | None:
        """Pose among the points of known depth: a motion too short to triangulate still moves near points."""
        mine, theirs = self._depths.common(tracks.ids)
        depths = self._depths[mine]
        points = rays(self.camera, tracks.reference[theirs]) / depths.values[:, None]
        located = locate(points, tracks.current[theirs], self.camera, self.settings, self._seed())
        if located is None:
            return None
        ref_T_cur, covariance, inliers = located
        kept = np.ones(len(tracks), bool)
        kept[theirs[~inliers]] = False
        travel = np.concatenate([np.zeros(3), ref_T_cur.rotation().unrotate(ref_T_cur.translation())])
        covariance = covariance + self._map_variance * np.outer(travel, travel)
        return _Motion(ref_T_cur, covariance, tracks[kept], self._depths)

    def _turn(self, tracks: Tracks, rotation: gtsam.Rot3, parallax: float) -> _Motion:
        """Rotation alone; the translation is as uncertain as the parallax that it may have caused."""
        assert self._reference is not None
        noise = self.settings.static_parallax / self.camera.fx
        hidden = max(parallax, self.settings.static_parallax) / self.camera.fx * self._typical_depth(self._reference)
        covariance = np.diag(np.repeat([noise, hidden], 3) ** 2)
        return _Motion(gtsam.Pose3(rotation, np.zeros(3)), covariance, tracks, self._depths)

    def _accept(self, frame: Frame, motion: _Motion) -> VoEstimate:
        """Take over a measured motion; refer to this frame from now on where it saw enough that is new."""
        last_T_cur = self._ref_T_last.between(motion.ref_T_cur)
        self._motion_model.observe(last_T_cur, frame.stamp - self._last_stamp)
        self._ref_T_last, self._covariance, self._last_stamp = motion.ref_T_cur, motion.covariance, frame.stamp
        self._seen, self._failures = motion.tracks, 0
        estimate = self._estimate(
            frame, self._index(), motion.ref_T_cur, motion.covariance, Status.TRACKED, motion.tracks
        )
        if motion.scale is not None:
            self._map_variance = motion.scale.variance
        if motion.scale is not None or len(motion.tracks) < self.settings.keyframe_tracks * self._points:
            mine, theirs = motion.depths.common(motion.tracks.ids)
            seen = rays(self.camera, motion.tracks.reference[theirs])
            self._refer_to(frame, motion.tracks, motion.depths[mine].moved(seen, motion.ref_T_cur))
        return replace(estimate, scale=motion.scale)

    def _lose(self, frame: Frame) -> VoEstimate:
        """The image does not fit the reference: a bad image is passed over, a changed scene becomes the reference."""
        assert frame.image is not None
        if len(detect(frame.image, self._features)) < self.settings.min_inliers:
            return self._coast(frame, Status.COASTED)
        self._failures += 1
        if self._failures < PATIENCE:
            return self._coast(frame, Status.COASTED)
        estimate = self._coast(frame, Status.REINITIALISED)
        self._refer_to(frame, Tracks.none(), InverseDepths.none())
        self._last_stamp = frame.stamp
        return estimate

    def _coast(self, frame: Frame, status: Status) -> VoEstimate:
        """The motion model carries on from the last usable image."""
        step, spread = self._motion_model.predict(frame.stamp - self._last_stamp)
        covariance = compose_covariance(self._covariance, step, spread)
        return self._estimate(frame, self._index(), self._ref_T_last.compose(step), covariance, status)

    def _refer_to(self, frame: Frame, kept: Tracks, depths: InverseDepths) -> None:
        assert frame.image is not None
        with self._stopwatch.stage("detection"):
            self._seen = self._association.rebase(frame.image, kept)
        self._reference, self._depths, self._points = frame, depths, len(self._seen)
        self._ref_T_last, self._covariance = gtsam.Pose3(), np.zeros((6, 6))
        self._failures = 0

    def _index(self) -> int:
        return 0 if self._reference is None else self._reference.index

    def _seed(self) -> int:
        return int(self._rng.integers(2**31))

    def _typical_depth(self, frame: Frame) -> float:
        """Metres to what is seen: of the map, else of the ground, else a guess."""
        if len(self._depths):
            return float(1 / np.median(self._depths.values))
        return frame.height if frame.height > 0 else 10.0

    def _estimate(
        self,
        frame: Frame,
        previous: int,
        prev_T_cur: gtsam.Pose3,
        covariance: Covariance,
        status: Status,
        tracks: Tracks | None = None,
    ) -> VoEstimate:
        tracks = tracks or Tracks.none()
        times = self._stopwatch.times
        return VoEstimate(frame.index, previous, prev_T_cur, covariance, status, tracks, found=len(tracks), times=times)


def _metric_covariance(two_view: TwoView, scale: LogScale) -> Covariance:
    """Covariance (6, 6) of the metric pose: what two views tell, and the scale along the baseline."""
    cur_R_prev = two_view.rotation.matrix().T
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = np.eye(3)
    jacobian[3:, 3:5] = scale.metres * cur_R_prev @ gtsam.Unit3(two_view.direction).basis()
    jacobian[3:, 5] = scale.metres * cur_R_prev @ two_view.direction
    measured = np.zeros((6, 6))
    measured[:5, :5] = two_view.covariance
    measured[5, 5] = scale.variance
    covariance: Covariance = jacobian @ measured @ jacobian.T
    return (covariance + covariance.T) / 2
