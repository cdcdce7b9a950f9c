"""How well landmarks are seen: measured by how far their views are from where they meet."""

from __future__ import annotations

import math

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera

Array = NDArray[np.float64]

MIN_FREE_NUMBERS = 20  # numbers that tell a noise
NOISE_SMOOTHING = 0.1  # weight of the newest frame
BY_MEDIAN = 1 / 0.6745  # deviation of a normal distribution by the median of absolute values


class PixelNoise:
    """The standard deviation of a landmark's pixel along each axis, by the residuals of those seen now.

    It is robust (by the median) and allows for what the landmarks' own positions have taken up: 3 of the 2 M numbers of
    a landmark with M views.

    Args:
        sigma: Pixels, where nothing was measured yet.
    """

    def __init__(self, sigma: float) -> None:
        self.sigma = sigma
        self._views: dict[int, list[tuple[int, Array]]] = {}  # frames and pixels of each landmark

    def see(self, landmark: int, frame: int, pixel: Array) -> None:
        """Take in a view of a landmark: its pixel (2,)."""
        self._views.setdefault(landmark, []).append((frame, pixel))

    def learn(self, points: dict[int, Array], poses: list[gtsam.Pose3], camera: Camera) -> None:
        """Take in where landmarks are now; those that are not named are forgotten.

        Args:
            points: (3,) in the world, metres, by landmark.
            poses: world_T_camera of all frames.
            camera: As it is known now.
        """
        self._views = {landmark: views for landmark, views in self._views.items() if landmark in points}
        frames = np.array([frame for views in self._views.values() for frame, _ in views], np.intp)
        pixels = np.array([pixel for views in self._views.values() for _, pixel in views])
        free = 2 * len(pixels) - 3 * len(self._views)
        if free < MIN_FREE_NUMBERS:
            return
        counts = [len(views) for views in self._views.values()]
        there = np.repeat([points[landmark] for landmark in self._views], counts, axis=0)
        camera_T_world = {frame: poses[frame].inverse().matrix() for frame in set(frames.tolist())}
        matrices = np.array([camera_T_world[frame] for frame in frames.tolist()])
        seen = np.einsum("nij,nj->ni", matrices[:, :3, :3], there) + matrices[:, :3, 3]
        error = camera.project(seen) - pixels
        variance = (BY_MEDIAN * float(np.median(np.abs(error)))) ** 2 * error.size / free
        if math.isfinite(variance):  # a landmark may have come to lie in a camera
            self.sigma = math.sqrt(self.sigma**2 + NOISE_SMOOTHING * (variance - self.sigma**2))
