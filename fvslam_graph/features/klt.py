"""Association by pyramidal Lucas-Kanade tracking."""

from __future__ import annotations

from dataclasses import replace

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image
from fvslam_graph.core.config import FeatureSettings
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.features.alignment_bias import alignment_bias
from fvslam_graph.features.brightness import relative_brightness
from fvslam_graph.features.detection import BORDER, detect
from fvslam_graph.features.texture import Texture
from fvslam_graph.features.turn import expected_turn, turned_back

MOST = 0.5  # of the points that were followed, which are found as long as the image shows the same scene
NEAR = 9  # points that go about the same way
SEARCH_LEVELS = 2  # by which they are looked for higher in the pyramid, where nothing tells how far they go
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.02)


class KltTracker:
    """Aligns each point's patch in the keyframe with the current image (Bouguet 2000), checked backwards.

    Every image is aligned with the keyframe itself, never with the image before, so that errors do not add up while
    one image stays the keyframe. A point is looked for where it would be if it went on as from the image before.
    Where the camera has rolled, the image is turned back before. Brightness is relative to that of the surroundings, as
    far as the coarsest patch reaches.
    """

    def __init__(self, settings: FeatureSettings) -> None:
        self.settings = settings
        self._reach = settings.klt_window << settings.klt_levels
        self._image: Image | None = None  # the keyframe, in relative brightness
        self._last: Image | None = None  # image as it came,
        self._last_relative: Image | None = None  # and in relative brightness
        self._next_id = 0
        self._ids = np.empty(0, np.int64)
        self._points = np.empty((0, 2), np.float32)
        self._covariances = np.empty((0, 2, 2))
        self._bias = np.empty((0, 2, 2, 2))
        self._seen = self._points  # where they were last,
        self._steps = self._points  # and how far they went from one image to the next
        self._followed = np.empty(0, bool)  # of which that is known

    def track(self, image: Image) -> Tracks:
        """The points of the keyframe that are found in `image`, forwards and back within `klt_backward` pixels."""
        if self._image is None or not len(self._points):
            return Tracks.none()
        image = self._relative(image)
        expected, turn = self._seen + self._steps, None
        if self._followed.any():
            turn = expected_turn(self._points[self._followed], expected[self._followed])
        else:
            expected = self._roughly(image)
        found, good = self._follow(self._image, image, expected, turn)
        self._steps = np.where(good[:, None], found - self._seen, self._steps)
        self._seen = np.where(good[:, None], found, self._seen)
        if good.sum() > MOST * self._followed.sum():  # fewer may be there by chance
            self._followed = good
        points, current = self._points[good].astype(float), found[good].astype(float)
        tracks = Tracks(self._ids[good], points, current, self._covariances[good], self._bias[good])
        if turn is None:
            return tracks
        R = turn.rotation().matrix()
        return replace(tracks, covariances=R @ tracks.covariances @ R.T, turn=turn.theta())

    def set_keyframe(self, image: Image, kept: Tracks) -> Tracks:
        """Make `image` the keyframe: its points, the kept tracks and new corners, are returned."""
        image = self._image = self._relative(image)
        texture = Texture.of(image, self.settings.octave)
        corners = detect(texture, self.settings, kept.current)
        self._steps = self._expected_steps(kept, corners)
        self._points = np.vstack([kept.current, corners]).astype(np.float32)
        self._ids = np.concatenate([kept.ids, self._next_id + np.arange(len(corners))])
        self._next_id += len(corners)
        self._seen = self._points
        self._followed = np.arange(len(self._points)) < len(kept)
        points = self._points.astype(float)
        self._covariances = texture.displacement_covariances(points)
        self._bias = alignment_bias(image, self._points, self.settings.klt_window)
        return Tracks(self._ids, points, points, self._covariances, self._bias)

    def _relative(self, image: Image) -> Image:
        if image is not self._last or self._last_relative is None:
            self._last, self._last_relative = image, relative_brightness(image, self._reach)
        return self._last_relative

    def _expected_steps(self, kept: Tracks, corners: NDArray[np.float32]) -> NDArray[np.float32]:
        """How far points will go to the next image, (N, 2): as far as before, new corners as far as what is near."""
        if not len(kept):
            return np.zeros((len(corners), 2), np.float32)
        _, mine, theirs = np.intersect1d(self._ids, kept.ids, assume_unique=True, return_indices=True)
        steps = np.zeros((len(kept), 2), np.float32)
        steps[theirs] = self._steps[mine]
        near = ((kept.current**2).sum(axis=1) - 2 * corners @ kept.current.T).argmin(axis=1)
        return np.vstack([steps, steps[near]])

    def _roughly(self, image: Image) -> NDArray[np.float32]:
        """Where the points may be, (N, 2), if nothing tells how far they went: as far as most that are near."""
        assert self._image is not None
        found, good = self._align(
            self._image, image, self._points, self._points, self.settings.klt_levels + SEARCH_LEVELS
        )
        steps = (found - self._points)[good]
        if len(steps) < NEAR:
            return self._points
        off = (self._points[:, None] - self._points[None, good]) ** 2
        near = off.sum(axis=2).argpartition(NEAR - 1, axis=1)[:, :NEAR]
        return np.asarray(self._points + np.median(steps[near], axis=1), np.float32)

    def _follow(
        self, keyframe: Image, image: Image, expected: NDArray[np.float32], turn: gtsam.Pose2 | None
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Pixels (N, 2) where the points are in the image, and (N,) whether the way back leads to where they were."""
        height, width = image.shape
        if turn is not None:
            image = turned_back(image, turn)
            expected = turn.transformTo(expected.T.astype(float)).T.astype(np.float32)
        found, forward = self._align(keyframe, image, self._points, expected, self.settings.klt_levels)
        # The way back starts at the answer, so that the full image suffices.
        returned, backward = self._align(image, keyframe, found, self._points, 0)
        if turn is not None:
            found = turn.transformFrom(found.T.astype(float)).T.astype(np.float32)
        inside = np.all((found > BORDER) & (found < (width - BORDER - 1, height - BORDER - 1)), axis=1)
        error = np.hypot(*(returned - self._points).T)
        return found, forward & backward & inside & (error < self.settings.klt_backward)

    def _align(
        self, a: Image, b: Image, points: NDArray[np.float32], guess: NDArray[np.float32], levels: int
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        window = (self.settings.klt_window, self.settings.klt_window)
        found, status, _ = cv2.calcOpticalFlowPyrLK(
            a, b, points, guess.copy(), None, None, window, levels, _STOP, cv2.OPTFLOW_USE_INITIAL_FLOW
        )
        return found, status[:, 0] > 0
