"""The estimate of V-SLAM for a frame."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.trajectory import Status

Array = NDArray[np.float64]


class MatchOutcome(IntEnum):
    """Says what became of a landmark in a frame."""

    OUT_OF_VIEW = 0
    UNMATCHED = 1  # expected in view and not found
    REJECTED = 2  # found, but neither of the following
    INLIER = 3  # low innovation: agrees with the hypothesis of the RANSAC
    RESCUED = 4  # high innovation: agrees with the state that these have updated


@dataclass(frozen=True)
class LandmarkMatches:
    """Matches of the N landmarks that were in the map before a frame.

    Attributes:
        ids: (N,) the same for the same landmark at all times.
        outcome: (N,) of MatchOutcome.
        expected: (N, 2) pixels where they were looked for.
        ellipses: (N, 2, 2) covariance of the innovation, pixels^2.
        pixels: (N, 2) where they were found; NaN where they were not.
    """

    ids: NDArray[np.int64]
    outcome: NDArray[np.int64]
    expected: Array
    ellipses: Array
    pixels: Array

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def none(cls) -> Self:
        """No landmarks."""
        ids, pixels = np.empty(0, np.int64), np.empty((0, 2))
        return cls(ids, ids, pixels, np.empty((0, 2, 2)), pixels)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(N,) which took part in an update."""
        measured: NDArray[np.bool_] = self.outcome >= MatchOutcome.INLIER
        return measured

    @property
    def nis(self) -> float:
        """Normalised innovation squared, mean over what was measured: 2 is consistent; NaN where nothing was."""
        if not self.measured.any():
            return np.nan
        innovations = (self.pixels - self.expected)[self.measured]
        weighted = np.linalg.solve(self.ellipses[self.measured], innovations[:, :, None])[:, :, 0]
        return float(np.mean(np.sum(innovations * weighted, axis=1)))


@dataclass(frozen=True)
class Landmarks:
    """The map after a frame: N landmarks in view, of which some begin there.

    Attributes:
        ids: (N,) the same for the same landmark at all times.
        pixels: (N, 2) where they are in the image, as the map has them.
        points: (N, 3) in the camera, metres.
        covariances: (N, 3, 3) of the points, in which they share the uncertainty of the scale.
        ages: (N,) frames since they began; 0 for those that begin.
    """

    ids: NDArray[np.int64]
    pixels: Array
    points: Array
    covariances: Array
    ages: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True)
class LandmarkObservations:
    """Observations of N landmarks in one image.

    Attributes:
        ids: (N,) the same for the same landmark at all times.
        pixels: (N, 2) where they are.
        points: (N, 3) where they are in the camera as visual SLAM has it, metres; NaN where it has dropped them.
        covariances: (N, 3, 3) of the points.
    """

    ids: NDArray[np.int64]
    pixels: NDArray[np.float64]
    points: NDArray[np.float64]
    covariances: NDArray[np.float64]


@dataclass(frozen=True)
class SlamEstimate:
    """The pose of one frame.

    Attributes:
        index: Of the frame.
        previous: Index of the frame of the step before.
        pose: world_T_camera.
        prev_T_cur: Motion since the step before.
        status: How it came about.
        matches: What became of the map's landmarks.
        landmarks: The map from now on.
        scale_sigma: Standard deviation of the logarithm of the scale that the map shares; NaN without landmarks.
        times: Milliseconds by stage.
    """

    index: int
    previous: int
    pose: GaussianPose
    prev_T_cur: GaussianPose
    status: Status
    matches: LandmarkMatches
    landmarks: Landmarks
    scale_sigma: float
    times: dict[str, float]

    @property
    def observations(self) -> LandmarkObservations:
        """Landmarks that were measured in this frame, and those that begin in it."""
        measured, new = self.matches.measured, self.landmarks.ages == 0
        ids = np.concatenate([self.matches.ids[measured], self.landmarks.ids[new]])
        pixels = np.vstack([self.matches.pixels[measured], self.landmarks.pixels[new]])
        points, covariances = np.full((len(ids), 3), np.nan), np.full((len(ids), 3, 3), np.nan)
        _, mine, theirs = np.intersect1d(ids, self.landmarks.ids, assume_unique=True, return_indices=True)
        points[mine], covariances[mine] = self.landmarks.points[theirs], self.landmarks.covariances[theirs]
        return LandmarkObservations(ids, pixels, points, covariances)
