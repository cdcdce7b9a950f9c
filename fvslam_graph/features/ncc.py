"""Association by matching the patches around FAST corners: the paper's matched patterns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image
from fvslam_graph.core.config import FeatureSettings
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.features.detection import detect
from fvslam_graph.features.texture import Texture

PATCH = 11  # pixels, side of a patch
_X, _Y = np.array([1, 0]), np.array([0, 1])


class NccMatcher:
    """Matches corners whose patches have the highest zero-mean normalised cross-correlation, mutually.

    Corners are detected in both images; a pair is a match where each is the other's best within the search radius and
    their correlation is above the threshold (Nister, Naroditsky, Bergen 2004, section 2). The peak of the correlation
    around the match is then found to a fraction of a pixel, since corners lie on whole pixels in both images and
    their rounding would be alike over the whole image.
    """

    def __init__(self, settings: FeatureSettings) -> None:
        self.settings = settings
        self._next_id = 0
        self._ids = np.empty(0, np.int64)
        self._points = np.empty((0, 2))
        self._patches = np.empty((0, PATCH * PATCH), np.float32)

    def track(self, image: Image) -> Tracks:
        """The corners of the keyframe that are matched with corners of `image`."""
        corners = np.rint(detect(Texture.of(image, self.settings.octave), self.settings)).astype(np.intp)
        if not len(self._points) or not len(corners):
            return Tracks.none()
        correlation = self._patches @ _patches(image, corners).T
        for axis in (0, 1):
            distance = np.abs(self._points[:, None, axis] - corners[None, :, axis])
            correlation[distance > self.settings.ncc_radius] = -1.0
        best, best_back = correlation.argmax(axis=1), correlation.argmax(axis=0)
        rows = np.arange(len(best))
        good = (best_back[best] == rows) & (correlation[rows, best] > self.settings.ncc_threshold)
        # What a patch is centred on is a whole pixel, its point need not be.
        beside = self._points[good] - np.rint(self._points[good])
        found = _peak(image, corners[best[good]], self._patches[good]) + beside
        return Tracks.alike(self._ids[good], self._points[good], found)

    def set_keyframe(self, image: Image, kept: Tracks) -> Tracks:
        """Make `image` the keyframe: its points, the kept tracks and new corners, are returned."""
        corners = detect(Texture.of(image, self.settings.octave), self.settings, kept.current)
        self._points = np.vstack([kept.current, corners])
        self._ids = np.concatenate([kept.ids, self._next_id + np.arange(len(corners))])
        self._next_id += len(corners)
        self._patches = _patches(image, np.rint(self._points).astype(np.intp))
        return Tracks.alike(self._ids, self._points, self._points)


def _patches(image: Image, centres: NDArray[np.intp]) -> NDArray[np.float32]:
    """Patches around whole pixels (N, 2), as rows (N, PATCH^2) of zero mean and unit length."""
    windows = np.lib.stride_tricks.sliding_window_view(image, (PATCH, PATCH))
    corner = centres - PATCH // 2
    rows = windows[corner[:, 1], corner[:, 0]].reshape(-1, PATCH * PATCH).astype(np.float32)
    rows -= rows.mean(axis=1, keepdims=True)
    unit: NDArray[np.float32] = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-6)
    return unit


def _peak(image: Image, matches: NDArray[np.intp], patches: NDArray[np.float32]) -> NDArray[np.float64]:
    """Where around each match (N, 2) the correlation with its patch (N, PATCH^2) peaks: a parabola along each axis."""
    middle = (_patches(image, matches) * patches).sum(axis=1)
    shifts = []
    for step in (_X, _Y):
        before = (_patches(image, matches - step) * patches).sum(axis=1)
        after = (_patches(image, matches + step) * patches).sum(axis=1)
        curvature = before - 2 * middle + after
        shift = (before - after) / (2 * np.minimum(curvature, -1e-6))
        shifts.append(np.clip(shift, -0.5, 0.5))
    peaks: NDArray[np.float64] = matches + np.column_stack(shifts)
    return peaks
