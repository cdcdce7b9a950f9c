"""The eyes of odometry in a simulated scene: points are followed by their number, without images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.camera import Image
from fvslam_graph.features.tracks import Tracks
from fvslam_graph.sequences.points import PointScene, frame_number


class SceneTracker:
    """Sees points of a scene where the scene says that they are seen; images only tell their number.

    Args:
        scene: Landmarks, their pixels and the noise of these.
        count: How many points are followed at most.
        wrong: Share of the matches that are anywhere in the image instead.
        seed: Of the choice of points and of wrong matches.
    """

    def __init__(self, scene: PointScene, count: int, wrong: float = 0.0, seed: int = 0) -> None:
        self.scene = scene
        self.count = count
        self.wrong = wrong
        self._rng = np.random.default_rng([seed, 3])
        self._ids = np.empty(0, np.int64)
        self._points = np.empty((0, 2))

    def track(self, image: Image) -> Tracks:
        """The points of the reference that are in view."""
        ids, pixels = self._seen(image)
        _, mine, theirs = np.intersect1d(self._ids, ids, assume_unique=True, return_indices=True)
        is_wrong = self._rng.random(len(mine)) < self.wrong
        camera = self.scene.camera
        anywhere = self._rng.uniform(0, (camera.width - 1, camera.height - 1), (len(mine), 2))
        found = np.where(is_wrong[:, None], anywhere, pixels[theirs])
        return Tracks(self._ids[mine], self._points[mine], found)

    def rebase(self, image: Image, kept: Tracks) -> Tracks:
        """Make `image` the reference: the kept tracks, and others in view up to the number wanted."""
        ids, pixels = self._seen(image)
        new = np.flatnonzero(~np.isin(ids, kept.ids))
        new = self._rng.permutation(new)[: max(self.count - len(kept), 0)]
        self._ids = np.concatenate([kept.ids, ids[new]])
        self._points = np.vstack([kept.current, pixels[new]])
        return Tracks(self._ids, self._points, self._points)

    def _seen(self, image: Image) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        seen = self.scene.observe(frame_number(image))
        return seen.ids, seen.pixels
