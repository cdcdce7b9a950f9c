"""The eyes of odometry in a simulated scene: points are followed by their number, without images."""

from __future__ import annotations

import numpy as np

from fvslam_graph.core.camera import Image
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.simulation.points import PointScene, frame_number


class SceneTracker:
    """Follows the points of a scene as a tracker does; images only tell their number.

    A tracker aligns a point's patch in the keyframe with the current one. It errs about the displacement, by the
    scene's noise, and goes on from where it found the point: a track drifts, and errors of consecutive pairs of images
    are independent. What it follows then is what is there, at the depth of the point.

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
        self._keyframe = 0  # frame
        self._ids = np.empty(0, np.int64)
        self._points = np.empty((0, 2))

    def track(self, image: Image) -> Tracks:
        """The points of the keyframe that are in view."""
        number = frame_number(image)
        mine = np.flatnonzero(np.isin(self._ids, self.scene.observe(number).ids))
        followed = self.scene.beside(self._keyframe, self._ids[mine], self._points[mine])
        exact = self.scene.exact(number, followed)
        found = exact + self.scene.noise * self._rng.standard_normal(exact.shape)
        is_wrong = self._rng.random(len(mine)) < self.wrong
        camera = self.scene.camera
        anywhere = self._rng.uniform(0, (camera.width - 1, camera.height - 1), (len(mine), 2))
        return Tracks.alike(self._ids[mine], self._points[mine], np.where(is_wrong[:, None], anywhere, found))

    def set_keyframe(self, image: Image, kept: Tracks) -> Tracks:
        """Make `image` the keyframe: the kept tracks, and others in view up to the number wanted."""
        self._keyframe = frame_number(image)
        seen = self.scene.observe(self._keyframe)
        new = np.flatnonzero(~np.isin(seen.ids, kept.ids))
        new = self._rng.permutation(new)[: max(self.count - len(kept), 0)]
        self._ids = np.concatenate([kept.ids, seen.ids[new]])
        self._points = np.vstack([kept.current, seen.pixels[new]])
        return Tracks.alike(self._ids, self._points, self._points)
