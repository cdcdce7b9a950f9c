"""Landmarks as patches of the image that they began in."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import FeatureSettings, SlamSettings
from fvslam_graph.core.landmark_finder import Search
from fvslam_graph.core.sequence import Frame
from fvslam_graph.features.detection import detect
from fvslam_graph.features.patches import REACH, align, cut_tiles, search, view_change, warp
from fvslam_graph.features.texture import Texture
from fvslam_graph.slam.inverse_depth import Array
from fvslam_graph.slam.measurement import PIXEL_GATE

MAX_SHIFT = 3.0  # pixels that the alignment may move along each axis from where the search ended
COARSE_SHARE = 0.8  # of the correlation threshold that has to be reached in the image halved
CHOICE = 4  # corners per landmark to choose from


class PatchFinder:
    """Searches each landmark's reference patch, warped to the predicted view, inside its ellipse.

    A landmark that odometry follows is not searched, but aligned with its patch from where odometry has it.

    The patch is never replaced by a later view, so that a landmark does not wander over its life (Davison 2003).

    Args:
        camera: Of the rectified images.
        features: How corners are detected.
        settings: Size of a patch, least correlation, extent of the search.
    """

    def __init__(self, camera: Camera, features: FeatureSettings, settings: SlamSettings) -> None:
        self.camera = camera
        self.settings = settings
        # A patch is larger than what odometry follows, and so is what makes it stand out.
        octave = min(features.octave + 1, 3)
        self._features = features.model_copy(update={"count": CHOICE * settings.min_landmarks, "octave": octave})
        side = 2 * REACH + 1
        self._ids = np.empty(0, np.int64)
        self._tiles = np.empty((0, side, side), np.uint8)
        self._centres = np.empty((0, 2))
        self._anchor_T_map = np.empty((0, 4, 4))

    def find(self, frame: Frame, search_for: Search) -> tuple[Array, NDArray[np.bool_]]:
        """Pixels (N, 2) and which were found, (N,)."""
        assert frame.image is not None
        settings, rows = self.settings, np.searchsorted(self._ids, search_for.ids)
        anchor_T_camera = self._anchor_T_map[rows] @ search_for.map_T_camera.matrix()
        change = view_change(anchor_T_camera, search_for.points, self.camera)
        patches, within = warp(self._tiles[rows], self._centres[rows], change)
        pixels, correlation = search_for.followed.copy(), np.ones(len(patches))
        sought = np.isnan(pixels[:, 0])
        if sought.any():
            pixels[sought], correlation[sought] = search(
                frame.image,
                patches[sought],
                search_for.pixels[sought],
                search_for.covariances[sought],
                PIXEL_GATE,
                settings.search_radius,
            )
        candidates = np.flatnonzero(within & (correlation > COARSE_SHARE * settings.ncc_threshold))
        aligned, correlation = align(frame.image, patches[candidates], pixels[candidates])
        moved = np.abs(aligned - pixels[candidates]).max(axis=1, initial=0.0)
        good = (moved < MAX_SHIFT) & (correlation > settings.ncc_threshold)
        found = np.zeros(len(pixels), bool)
        found[candidates[good]] = True
        pixels[candidates[good]] = aligned[good]
        if not settings.alignment:
            found[~sought], pixels[~sought] = True, search_for.followed[~sought]
        return pixels, found

    def candidates(self, frame: Frame, taken: Array) -> Array:
        """FAST corners (K, 2) away from `taken`, (M, 2)."""
        assert frame.image is not None
        return detect(Texture.of(frame.image, self._features.octave), self._features, taken).astype(float)

    def remember(self, frame: Frame, ids: NDArray[np.int64], pixels: Array, map_T_camera: gtsam.Pose3) -> None:
        """Keep the patches around pixels (K, 2)."""
        assert frame.image is not None
        self._ids = np.concatenate([self._ids, ids])
        self._tiles = np.concatenate([self._tiles, cut_tiles(frame.image, pixels)])
        self._centres = np.vstack([self._centres, REACH + pixels - np.rint(pixels)])
        anchor = np.broadcast_to(map_T_camera.inverse().matrix(), (len(ids), 4, 4))
        self._anchor_T_map = np.concatenate([self._anchor_T_map, anchor])

    def forget(self, kept: NDArray[np.int64]) -> None:
        """Drop all landmarks but these."""
        stay = np.searchsorted(self._ids, kept)
        self._ids, self._tiles = self._ids[stay], self._tiles[stay]
        self._centres, self._anchor_T_map = self._centres[stay], self._anchor_T_map[stay]
