"""The front end of the filter: it finds landmarks in images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.sequence import Frame

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Search:
    """Where N landmarks are to be looked for.

    Attributes:
        ids: (N,) of the landmarks.
        pixels: (N, 2) where they are expected.
        covariances: (N, 2, 2) of the difference between a match and the expectation, pixels^2.
        followed: (N, 2) pixels to which odometry has followed them; NaN where it has not.
        points: (N, 3) where they are in this camera, metres.
        map_T_camera: Expected pose of the camera, in the frame of the poses given to `remember`.
    """

    ids: NDArray[np.int64]
    pixels: Array
    covariances: Array
    followed: Array
    points: Array
    map_T_camera: gtsam.Pose3


class LandmarkFinder(Protocol):
    """Chooses new landmarks and finds them again."""

    def find(self, frame: Frame, search: Search) -> tuple[Array, NDArray[np.bool_]]:
        """Match landmarks within their ellipses; pixels (N, 2), of no meaning where not found, and which were (N,)."""

    def candidates(self, frame: Frame, taken: Array) -> Array:
        """Pixels (K, 2) of what can become new landmarks, away from `taken`, (M, 2)."""

    def remember(self, frame: Frame, ids: NDArray[np.int64], pixels: Array, map_T_camera: gtsam.Pose3) -> None:
        """Keep what new landmarks at pixels (K, 2) look like, seen from a pose."""

    def forget(self, kept: NDArray[np.int64]) -> None:
        """Drop all landmarks but these."""
