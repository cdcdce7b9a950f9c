"""Association by matching the patches around FAST corners: the paper's matched patterns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.camera import Image
from fvslam_graph.config import FeatureSettings
from fvslam_graph.features.detection import detect
from fvslam_graph.features.tracks import Tracks

PATCH = 11  # pixels, side of a patch


class NccMatcher:
    """Matches corners whose patches have the highest zero-mean normalised cross-correlation, mutually.

    Corners are detected in both images; a pair is a match where each is the other's best within the search radius and
    their correlation is above the threshold (Nister, Naroditsky, Bergen 2004, section 2).
    """

    def __init__(self, settings: FeatureSettings) -> None:
        self.settings = settings
        self._next_id = 0
        self._ids = np.empty(0, np.int64)
        self._points = np.empty((0, 2), np.float32)
        self._patches = np.empty((0, PATCH * PATCH), np.float32)

    def track(self, image: Image) -> Tracks:
        """The corners of the reference that are matched with corners of `image`."""
        corners = detect(image, self.settings)
        if not len(self._points) or not len(corners):
            return Tracks.none()
        correlation = self._patches @ _patches(image, corners).T
        shift = np.abs(self._points[:, None] - corners[None]).max(axis=2)
        correlation[shift > self.settings.ncc_radius] = -1.0
        best, best_back = correlation.argmax(axis=1), correlation.argmax(axis=0)
        rows = np.arange(len(best))
        good = (best_back[best] == rows) & (correlation[rows, best] > self.settings.ncc_threshold)
        return Tracks(self._ids[good], self._points[good].astype(float), corners[best[good]].astype(float))

    def rebase(self, image: Image, kept: Tracks) -> Tracks:
        """Make `image` the reference: its points, the kept tracks and new corners, are returned."""
        corners = detect(image, self.settings, kept.current)
        self._points = np.vstack([kept.current, corners]).astype(np.float32)
        self._ids = np.concatenate([kept.ids, self._next_id + np.arange(len(corners))])
        self._next_id += len(corners)
        self._patches = _patches(image, self._points)
        points = self._points.astype(float)
        return Tracks(self._ids, points, points)


def _patches(image: Image, points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Patches around points (N, 2), as rows (N, PATCH^2) of zero mean and unit length."""
    windows = np.lib.stride_tricks.sliding_window_view(image, (PATCH, PATCH))
    corner = np.rint(points).astype(int) - PATCH // 2
    rows = windows[corner[:, 1], corner[:, 0]].reshape(len(points), -1).astype(np.float32)
    rows -= rows.mean(axis=1, keepdims=True)
    unit: NDArray[np.float32] = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-6)
    return unit
