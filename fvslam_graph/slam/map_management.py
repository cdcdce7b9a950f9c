"""Which landmarks the map keeps, and which it takes in."""

from __future__ import annotations

import math

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import SlamSettings
from fvslam_graph.core.known_points import KnownPoints
from fvslam_graph.core.landmark_finder import LandmarkFinder
from fvslam_graph.core.sequence import Frame
from fvslam_graph.core.slam_estimate import LandmarkMatches, MatchOutcome
from fvslam_graph.features.patches import MARGIN
from fvslam_graph.slam.initialisation import depths_from_map, equal_depths, known_depths, with_new_landmarks
from fvslam_graph.slam.inverse_depth import Array, linearity_index
from fvslam_graph.slam.landmark_history import NO_TRACK, LandmarkHistory
from fvslam_graph.slam.state import State

SPACING = 15.0  # pixels at least between landmarks
TRIALS = 3  # how often a landmark is looked for before it is judged
MIN_SUCCESS = 0.5  # share of these in which it has to be measured
SHARE_SMOOTHING = 0.2  # weight of the newest frame in the share of landmarks that are measured
MIN_MEASURED_SHARE = 0.3  # below, more landmarks would not help
RESERVE = 1.15  # the map grows to so many times what it needs, so that not every image is searched for corners
RIM = 0.1  # of the image's height, in which no landmark begins, as it would soon be out of view
LINEARITY = 0.1  # index below which a landmark is taken as a point (Civera, Davison, Montiel 2008, section V)


class MapManager:
    """Takes in landmarks where the image has too few, and drops those that are of no use.

    Args:
        camera: Undistorted.
        settings: Size of the map, noise of a pixel, spread of depths.
        finder: Told of all that begin and end.
    """

    def __init__(self, camera: Camera, settings: SlamSettings, finder: LandmarkFinder) -> None:
        self.camera = camera
        self.settings = settings
        self.finder = finder
        self.history = LandmarkHistory.none()
        self.awaited = np.empty(0, np.int64)  # landmarks of maps that were lost: they are kept, as they may come back
        self._next_id = 0
        self._share = 1.0  # of the map that a frame measures
        self.distance = settings.unknown_distance  # metres, typical of what was seen last

    def prune(self, state: State, matches: LandmarkMatches) -> State:
        """Without landmarks out of view and those rarely measured; those known well enough become points.

        Args:
            state: In the present camera.
            matches: What became of its landmarks, in their order.
        """
        if len(matches):
            self._share += SHARE_SMOOTHING * (float(matches.measured.mean()) - self._share)
        in_view = matches.outcome != MatchOutcome.OUT_OF_VIEW
        self.history = self.history.counted(state.ids, in_view, matches.measured)
        mine = self.history.of(state.ids)
        rare = (mine.expected >= TRIALS) & (mine.measured < MIN_SUCCESS * mine.expected)
        _, inverse_depth, _ = state.parts
        index = linearity_index(
            state.anchored_inverse_depth, np.sqrt(np.diagonal(state.covariance)[inverse_depth[:, 2]])
        )
        return state.without(~in_view | rare, (index < LINEARITY) & (state.inverse_depth[:, 2] > 0))

    def add_landmarks(self, state: State, frame: Frame, points: KnownPoints | None, map_T_camera: gtsam.Pose3) -> State:
        """The state with as many new landmarks, away from those that exist, as the next frame may lack.

        Args:
            state: In the present camera.
            frame: The present image.
            points: What they are chosen from, with their depths; without it, they are corners as far away as the
                landmarks around them.
            map_T_camera: For the finder.
        """
        here = state.positions
        taken = self.camera.project(here)
        taken = taken[self.camera.contains(taken)]
        if (told := _of_known_distance(state)).any():
            self.distance = float(np.median(np.linalg.norm(here[told], axis=1)))
        # Some landmarks of the map will leave the view or not be found.
        needed = self.settings.min_landmarks / max(self._share, MIN_MEASURED_SHARE)
        if len(state) < needed and frame.image is not None:
            wanted = math.ceil(RESERVE * needed) - len(state)
            candidates = self.finder.candidates(frame, taken) if points is None else points.pixels
            inside = np.flatnonzero(self.camera.contains(candidates, MARGIN + RIM * self.camera.height))
            chosen = inside[spread_out(candidates[inside], taken, wanted)]
            if len(chosen):
                known = None if points is None else points[chosen]
                state = self._begin(state, frame, candidates[chosen], known, map_T_camera)
        self.history = self.history.of(np.union1d(state.ids, self.awaited))
        self.finder.forget(self.history.ids)
        return state

    def followed(self, state: State, points: KnownPoints | None) -> Array:
        """(N, 2) pixels to which odometry has followed each of the state's landmarks; NaN where it has not."""
        pixels = np.full((len(state), 2), np.nan)
        if points is not None and len(points):
            tracks = self.history.of(state.ids).tracks
            order = np.argsort(points.ids)
            rows = order[np.minimum(np.searchsorted(points.ids, tracks, sorter=order), len(points) - 1)]
            alive = points.ids[rows] == tracks
            pixels[alive] = points.pixels[rows[alive]]
        return pixels

    def ages(self, state: State, frame: int) -> NDArray[np.int64]:
        """(N,) frames from the beginning of each of the state's landmarks to frame number `frame`."""
        return frame - self.history.of(state.ids).born

    def _begin(
        self, state: State, frame: Frame, pixels: Array, points: KnownPoints | None, map_T_camera: gtsam.Pose3
    ) -> State:
        size, spread = len(state.covariance), self.settings.depth_spread
        if points is not None:
            prior = known_depths(points, self.camera, state)
        else:
            prior = depths_from_map(state, pixels, self.camera, spread) or equal_depths(
                len(pixels), self.distance, spread, size
            )
        ids = self._next_id + np.arange(len(pixels))
        self._next_id += len(pixels)
        state = with_new_landmarks(state, ids, pixels, prior, self.camera, self.settings.pixel_sigma)
        tracks = np.full(len(pixels), NO_TRACK) if points is None else points.ids
        self.history = self.history.begun(ids, frame.index, tracks)
        self.finder.remember(frame, ids, pixels, map_T_camera)
        return state


def _of_known_distance(state: State) -> NDArray[np.bool_]:
    """(N,) which landmarks are not as well endlessly far away: where the map errs, most of them may be."""
    rows = state.parts[1][:, 2]
    known = np.ones(len(state), bool)
    known[: len(rows)] = state.inverse_depth[:, 2] > np.sqrt(np.diagonal(state.covariance)[rows])
    return known


def spread_out(candidates: Array, taken: Array, count: int) -> NDArray[np.intp]:
    """Rows of up to `count` candidates (N, 2), far from those `taken` (M, 2) and from each other."""
    gap = np.linalg.norm(candidates[:, None] - taken, axis=2).min(axis=1, initial=np.inf)
    chosen: list[int] = []
    for _ in range(min(count, len(candidates))):
        farthest = int(np.argmax(gap))
        if gap[farthest] < SPACING:
            break
        chosen.append(farthest)
        gap = np.minimum(gap, np.linalg.norm(candidates - candidates[farthest], axis=1))
    return np.array(chosen, np.intp)
