"""The eyes of the filter in a simulated scene: landmarks are found by their number, without images."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.gates import chi2_gate
from fvslam_graph.core.known_points import KnownPoints
from fvslam_graph.core.landmark_finder import Search
from fvslam_graph.core.sequence import Frame
from fvslam_graph.simulation.points import PointScene

Array = NDArray[np.float64]

SEARCH_GATE = chi2_gate(0.999, 2)  # the rim of the ellipse
MIN_REACH = 20.0  # pixels at least that a wrong match may lie off


class SceneFinder:
    """Finds landmarks of a scene where the scene says that they are seen.

    Args:
        scene: Landmarks, their pixels and the noise of these.
        wrong: Share of the matches that are anywhere in the box around the ellipse instead.
        seed: Of wrong matches.
    """

    def __init__(self, scene: PointScene, wrong: float = 0.0, seed: int = 0) -> None:
        self.scene = scene
        self.wrong = wrong
        self._rng = np.random.default_rng(seed)
        self._ids = np.empty(0, np.int64)  # of the filter's landmarks, ascending,
        self._of_scene = np.empty(0, np.int64)  # which of the scene's they are,
        self._points = np.empty((0, 3))  # and where, world, metres: beside it, where they began on a drifted track

    def find(self, frame: Frame, search: Search) -> tuple[Array, NDArray[np.bool_]]:
        """Pixels (N, 2) and which were found, (N,)."""
        seen = self.scene.observe(frame.index)
        mine = np.searchsorted(self._ids, search.ids)
        wanted = self._of_scene[mine]
        rows = np.minimum(np.searchsorted(seen.ids, wanted), len(seen.ids) - 1)
        noise = seen.pixels[rows] - self._exact(frame.index, seen.ids[rows])
        off = self.scene.exact(frame.index, self._points[mine]) + noise - search.pixels
        square = np.einsum("ni,nij,nj->n", off, np.linalg.inv(search.covariances), off)
        found = (seen.ids[rows] == wanted) & (square < SEARCH_GATE)
        wrong = self._rng.random(len(found)) < self.wrong
        reach = np.sqrt(SEARCH_GATE * np.diagonal(search.covariances, axis1=1, axis2=2))
        anywhere = self._rng.uniform(-1, 1, off.shape) * np.maximum(reach, MIN_REACH)
        return search.pixels + np.where(wrong[:, None], anywhere, off), found | wrong

    def candidates(self, frame: Frame, taken: Array) -> Array:
        """Pixels (K, 2) of all landmarks in view."""
        return self.scene.observe(frame.index).pixels

    def remember(self, frame: Frame, ids: NDArray[np.int64], pixels: Array, map_T_camera: gtsam.Pose3) -> None:
        """Which landmarks of the scene are seen at or beside pixels (K, 2)."""
        seen = self.scene.observe(frame.index)
        rows = np.linalg.norm(seen.pixels[:, None] - pixels, axis=2).argmin(axis=0)
        self._ids = np.concatenate([self._ids, ids])
        self._of_scene = np.concatenate([self._of_scene, seen.ids[rows]])
        # The noise of this image is in the reference patch, too.
        noise = seen.pixels[rows] - self._exact(frame.index, seen.ids[rows])
        self._points = np.vstack([self._points, self.scene.beside(frame.index, seen.ids[rows], pixels - noise)])

    def forget(self, kept: NDArray[np.int64]) -> None:
        """Drop all landmarks but these."""
        stay = np.isin(self._ids, kept)
        self._ids, self._of_scene, self._points = self._ids[stay], self._of_scene[stay], self._points[stay]

    def _exact(self, frame: int, ids: NDArray[np.int64]) -> Array:
        return self.scene.exact(frame, self.scene.landmarks[ids])


def known_points(
    scene: PointScene, frame: int, sigma: float, scale_sigma: float, rng: np.random.Generator
) -> KnownPoints:
    """The points seen in a frame with inverse depths that are wrong by `sigma` each and `scale_sigma` all alike.

    Args:
        scene: Where they are.
        frame: Index.
        sigma: Standard deviation of the logarithm of an inverse depth.
        scale_sigma: Of the logarithm of their scale.
        rng: Of the errors.
    """
    seen = scene.observe(frame)
    true = 1 / scene.in_camera(frame)[seen.ids, 2]
    error = sigma * rng.standard_normal(len(true)) + scale_sigma * rng.standard_normal()
    inverse = true * np.exp(error)
    sigmas, nothing = np.maximum(sigma * inverse, 1e-12), np.zeros((len(true), 0))
    return KnownPoints(seen.ids, seen.pixels, inverse, sigmas, nothing, scale_sigma**2)
