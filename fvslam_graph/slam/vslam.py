"""EKF visual SLAM: the camera's pose among landmarks, frame by frame."""

from __future__ import annotations

import math
from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import SlamSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.known_points import KnownPoints
from fvslam_graph.core.landmark_finder import LandmarkFinder, Search
from fvslam_graph.core.sequence import Frame
from fvslam_graph.core.slam_estimate import LandmarkMatches, Landmarks, MatchOutcome, SlamEstimate
from fvslam_graph.core.stopwatch import Stopwatch
from fvslam_graph.core.trajectory import Status
from fvslam_graph.core.vo_estimate import OdometryMotion
from fvslam_graph.features.patches import MARGIN
from fvslam_graph.slam.covariances import keep_memory
from fvslam_graph.slam.inverse_depth import Array
from fvslam_graph.slam.landmark_history import NO_TRACK
from fvslam_graph.slam.map_management import MapManager
from fvslam_graph.slam.measurement import PIXEL_GATE, PixelModel, Prediction, predict_pixels, update
from fvslam_graph.slam.motion import (
    compose,
    last_motion,
    motion_from_velocity,
    predict_constant_velocity,
    predict_from_odometry,
    reanchored,
    with_scale_walk,
)
from fvslam_graph.slam.one_point_ransac import low_innovation_inliers
from fvslam_graph.slam.sighting import Remembered, Sighting
from fvslam_graph.slam.state import ODOMETRY, POSE, SCALE, VELOCITY, State

MAX_FAILURES = 3  # images in a row without enough matches before the map is rebuilt
MIN_CANDIDATES = 10  # corners that an image has at least, for a map to be built on it
NOISE_INFLATION = 4.0  # an image that did not fit the map may have been a motion that the noise does not allow for
MEMORY = 3.0  # seconds for which a lost map is looked for,
MIN_FOUND_SHARE = 0.4  # and of its landmarks that have to be measured then
UNKNOWN_SCALE = 0.7  # of log scale: scenes are as far away as the last one within a factor of two
UNKNOWN_RATE = 0.5  # rad/s, and distances to the landmarks per second: standard deviation where nothing is known


class VSlam:
    """Monocular EKF SLAM with a camera-centred state and landmarks in inverse depth.

    Source: Davison, "Real-time simultaneous localisation and mapping with a single camera", ICCV 2003; Civera, Grasa,
    Davison, Montiel 2010.

    Args:
        camera: Of the rectified images.
        settings: Noise, thresholds, size of the map.
        finder: Finds landmarks in the images.
        rng: Of the run.
    """

    def __init__(
        self, camera: Camera, settings: SlamSettings, finder: LandmarkFinder, rng: np.random.Generator
    ) -> None:
        self.camera = camera
        self.settings = settings
        self.finder = finder
        self._rng = rng
        keep_memory()
        self._map = MapManager(camera, settings, finder)
        self._stopwatch = Stopwatch()
        self._state: State | None = None
        self._map_T_camera = gtsam.Pose3()  # the motions as they were estimated, without the re-anchoring
        self.index, self._stamp = 0, math.nan  # of the last step
        self._seen: Remembered | None = None  # where the map was seen last, if that is not the last step
        self._lost: Remembered | None = None  # likewise of a map that was given up, and is looked for
        self._failures = 0  # usable images in a row that did not fit the map

    @property
    def started(self) -> bool:
        """Whether `start` was called."""
        return self._state is not None

    @property
    def tracks(self) -> NDArray[np.int64]:
        """Tracks of odometry that are landmarks of the map."""
        tracks = self._map.history.tracks
        followed: NDArray[np.int64] = tracks[tracks != NO_TRACK]
        return followed

    def start(
        self, frame: Frame, pose: GaussianPose, odometry: OdometryMotion, seconds: float, points: KnownPoints
    ) -> SlamEstimate:
        """Begin, or begin anew, with landmarks among points of known depth.

        Args:
            frame: The first frame.
            pose: world_T_camera of this frame.
            odometry: The motion that led there, which tells the velocity,
            seconds: and the time that it took.
            points: Of this frame, in the same scale.
        """
        self._stopwatch = Stopwatch()
        self._failures, self._seen = 0, None
        state = predict_from_odometry(State.at(pose.mean, pose.covariance), odometry, seconds)
        motion = last_motion(state, seconds)
        state = self._map.add_landmarks(state, frame, points, self._map_T_camera)
        return self._arrive(frame, state, motion, LandmarkMatches.none(), Status.TRACKED, frame.index)

    def step(
        self, frame: Frame, odometry: OdometryMotion | None = None, points: KnownPoints | None = None
    ) -> SlamEstimate:
        """Estimate the pose of the next frame, after `start`; frames come in the order of their stamps.

        Args:
            frame: The next frame.
            odometry: Motion prev_T_cur since the last step; without it, the velocity stays what it was, up to noise.
            points: What odometry follows: landmarks that began among its tracks are found there, and new ones begin
                with its depths. Without it, all are searched, and corners of unknown depth become landmarks.
        """
        assert self._state is not None, "start comes first"
        self._stopwatch = Stopwatch()
        noise_inflation = NOISE_INFLATION if self._failures else 1.0
        before = Remembered(self._state, self._map_T_camera, self.index, self._stamp)
        sighting = self._sight(frame, before, odometry, points, noise_inflation)
        if odometry is None and (found := self._found_again(frame)) is not None:
            sighting, self._lost = found, None
        self._map_T_camera = sighting.map_T_camera

        # Drop and begin landmarks.
        status, textured = self._judge(frame, sighting.lost)
        if status is Status.TRACKED:
            self._seen = None
        elif self._seen is None:
            self._seen = before
        with self._stopwatch.stage("map"):
            state = self._brought_up_to_date(sighting.state, frame, sighting.matches, status, points)
            new = ~np.isin(state.ids, sighting.state.ids)
            state = with_scale_walk(state, float(new.mean()) if len(new) else 0.0)
            estimate = self._arrive(frame, state, sighting.motion, sighting.matches, status, sighting.previous)
        if status is Status.COASTED and textured:
            return replace(estimate, pose=estimate.pose.after_loss(self._map.distance))
        return estimate

    def _sight(
        self,
        frame: Frame,
        before: Remembered,
        odometry: OdometryMotion | None,
        points: KnownPoints | None,
        noise_inflation: float,
    ) -> Sighting:
        """Step from an earlier state into the new camera, by what the image shows of its map; arguments of `step`."""
        seconds = frame.stamp - before.stamp

        # Predict the motion, and where it leads the landmarks to.
        with self._stopwatch.stage("filter"):
            if odometry is None:
                state = predict_constant_velocity(before.state, seconds, self.settings, noise_inflation)
            else:
                state = predict_from_odometry(before.state, odometry, seconds)
            prediction = predict_pixels(state, PixelModel(self.camera, seconds, self.settings.pixel_sigma))
            visible = prediction.in_front & self.camera.contains(prediction.pixels, MARGIN)
            ellipses = prediction.innovation_covariances(np.ones(len(state), bool))

        # Look for each landmark inside its ellipse.
        with self._stopwatch.stage("search"):
            pixels, found = self._search(frame, before, prediction, visible, ellipses, points)

        with self._stopwatch.stage("filter"):
            # Low-innovation inliers update the state first, so that high-innovation inliers differ from outliers.
            slack = self.settings.linearisation_slack
            inliers, votes = low_innovation_inliers(prediction, pixels, found, slack, self._rng)
            rescued = np.zeros(len(found), bool)
            lost = bool(votes < self.settings.min_matches or inliers.sum() < self.settings.min_share * found.sum())
            if not lost:
                updated = update(prediction, inliers, pixels)
                rescued = _agree(updated, pixels, found & ~inliers)
                state = update(updated, rescued, pixels).state

            # Step into the new camera.
            prev_T_cur, _ = motion_from_velocity(state.velocity, seconds)
            state = compose(state, seconds)
            motion = last_motion(state, seconds)

        outcome = np.where(
            found, MatchOutcome.REJECTED, np.where(visible, MatchOutcome.UNMATCHED, MatchOutcome.OUT_OF_VIEW)
        )
        if not lost:
            outcome[inliers], outcome[rescued] = MatchOutcome.INLIER, MatchOutcome.RESCUED
        matches = LandmarkMatches(
            state.ids, outcome, prediction.pixels, ellipses, np.where(found[:, None], pixels, np.nan)
        )
        return Sighting(state, motion, before.index, before.map_T_camera.compose(prev_T_cur), matches, lost)

    def _found_again(self, frame: Frame) -> Sighting | None:
        """Sight a map that was lost some seconds ago; None where this image does not show it."""
        if self._lost is None or frame.image is None:
            return None
        if frame.stamp - self._lost.stamp > MEMORY:
            self._lost = None
            return None
        sighting = self._sight(frame, self._lost, None, None, NOISE_INFLATION)
        measured = int(sighting.matches.measured.sum())
        return sighting if not sighting.lost and measured >= MIN_FOUND_SHARE * len(sighting.matches) else None

    def reset_pose(self, pose: GaussianPose) -> None:
        """Go on from another pose world_T_camera; the map in the camera stays as it is."""
        assert self._state is not None, "start comes first"
        self._state = reanchored(self._state, pose)

    def _search(
        self,
        frame: Frame,
        before: Remembered,
        prediction: Prediction,
        visible: NDArray[np.bool_],
        ellipses: Array,
        points: KnownPoints | None,
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Pixels (N, 2) of all landmarks, and which were found (N,)."""
        pixels, found = prediction.pixels.copy(), np.zeros(len(visible), bool)
        if frame.image is not None and visible.any():
            state = prediction.state
            prev_T_cur, _ = motion_from_velocity(state.velocity, prediction.model.seconds)
            search = Search(
                ids=state.ids[visible],
                pixels=prediction.pixels[visible],
                covariances=ellipses[visible],
                followed=self._map.followed(state, points)[visible],
                points=(state.positions[visible] - prev_T_cur.translation()) @ prev_T_cur.rotation().matrix(),
                map_T_camera=before.map_T_camera.compose(prev_T_cur),
            )
            pixels[visible], found[visible] = self.finder.find(frame, search)
        return pixels, found

    def _judge(self, frame: Frame, lost: bool) -> tuple[Status, bool]:
        """A bad image is passed over; after some that do not fit the map, it is given up for one that has texture.

        Returns:
            The status, and whether an image that does not fit has texture.
        """
        if frame.image is None:
            return Status.SKIPPED, False
        self._failures = self._failures + 1 if lost else 0
        if not lost:
            return Status.TRACKED, True
        textured = len(self.finder.candidates(frame, np.empty((0, 2)))) >= MIN_CANDIDATES
        return Status.REINITIALISED if textured and self._failures >= MAX_FAILURES else Status.COASTED, textured

    def _brought_up_to_date(
        self, state: State, frame: Frame, matches: LandmarkMatches, status: Status, points: KnownPoints | None
    ) -> State:
        """The state with its map as the next frame needs it."""
        if status is Status.TRACKED:
            state = self._map.prune(state, matches)
        elif status is Status.REINITIALISED:
            state = self._forgotten(state)
        else:
            return state
        return self._map.add_landmarks(state, frame, points, self._map_T_camera)

    def _forgotten(self, state: State) -> State:
        """The pose, which the camera may have been carried from, and what is left of the velocity, without a map.

        Nothing tells any more in which scale the next map is but the speed, odometry as far as this map has told its
        scale, and that scenes are about as far away.
        """
        self._lost = self._lost or self._seen
        self._map.awaited = self._lost.state.ids if self._lost else self._map.awaited
        distance = self._map.distance
        covariance = np.diag(np.repeat([UNKNOWN_RATE, UNKNOWN_RATE * distance], 3) ** 2)
        travel = GaussianPose(gtsam.Pose3.Expmap(state.velocity), covariance + state.covariance[VELOCITY, VELOCITY])
        pose = GaussianPose(state.world_T_camera, state.covariance[POSE, POSE]).after_loss(distance)
        alone = State.at(pose.mean, pose.covariance)
        alone.covariance[SCALE, SCALE] = UNKNOWN_SCALE**2
        alone.covariance[ODOMETRY, ODOMETRY] = state.covariance[ODOMETRY, ODOMETRY]
        alone = replace(alone, odometry_scale=state.odometry_scale)
        return predict_from_odometry(alone, OdometryMotion(travel, np.zeros(6), 1.0, 0.0), 1.0)

    def _arrive(
        self,
        frame: Frame,
        state: State,
        motion: GaussianPose,
        matches: LandmarkMatches,
        status: Status,
        previous: int,
    ) -> SlamEstimate:
        """Take over the state in the new camera, and say what it is."""
        self._state = state = state.with_scale_decoupled()
        self.index, self._stamp = frame.index, frame.stamp
        return SlamEstimate(
            index=frame.index,
            previous=previous,
            pose=GaussianPose(state.world_T_camera, state.covariance[POSE, POSE]),
            prev_T_cur=motion,
            status=status,
            matches=matches,
            landmarks=Landmarks(
                ids=state.ids,
                pixels=self.camera.project(state.positions),
                points=state.positions,
                covariances=state.position_covariances(),
                ages=self._map.ages(state, frame.index),
            ),
            scale_sigma=math.sqrt(state.covariance[SCALE, SCALE]),
            times=self._stopwatch.times,
        )


def _agree(prediction: Prediction, pixels: Array, rest: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the rest (N,) lie within what the updated state predicts."""
    agree = rest & prediction.in_front
    innovation = (pixels - prediction.pixels)[agree]
    S = prediction.innovation_covariances(agree)
    distance = (innovation * np.linalg.solve(S, innovation[:, :, None])[:, :, 0]).sum(axis=1)
    agree[agree] = distance < PIXEL_GATE
    return agree
