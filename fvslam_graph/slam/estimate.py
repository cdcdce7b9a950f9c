"""What V-SLAM says about a frame."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.estimates import GaussianPose
from fvslam_graph.slam.landmarks import Array
from fvslam_graph.trajectory import Status


class Outcome(IntEnum):
    """What became of a landmark in a frame."""

    OUT_OF_VIEW = 0
    UNMATCHED = 1  # expected in view and not found
    REJECTED = 2  # found, but neither of the following
    INLIER = 3  # low innovation: agrees with the hypothesis of the RANSAC
    RESCUED = 4  # high innovation: agrees with the state that these have updated
    NEW = 5  # begins at this frame


@dataclass(frozen=True)
class Landmarks:
    """N landmarks at a frame.

    Attributes:
        ids: (N,) the same for the same landmark at all times.
        outcome: (N,) of Outcome.
        expected: (N, 2) pixels where they were looked for.
        ellipses: (N, 2, 2) covariance of the innovation, pixels^2.
        pixels: (N, 2) where they were found; NaN where they were not.
        points: (N, 3) in the camera, after the frame, metres.
        covariances: (N, 3, 3) of the points.
        ages: (N,) frames since they began.
    """

    ids: NDArray[np.int64]
    outcome: NDArray[np.int64]
    expected: Array
    ellipses: Array
    pixels: Array
    points: Array
    covariances: Array
    ages: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.ids)

    def __add__(self, other: Landmarks) -> Landmarks:
        mine, theirs = ([getattr(part, field.name) for field in fields(part)] for part in (self, other))
        return Landmarks(*(np.concatenate(pair) for pair in zip(mine, theirs, strict=True)))

    @classmethod
    def none(cls) -> Landmarks:
        """No landmarks."""
        ids = np.empty(0, np.int64)
        pixels, squares = np.empty((0, 2)), np.empty((0, 2, 2))
        return cls(ids, ids, pixels, squares, pixels, np.empty((0, 3)), np.empty((0, 3, 3)), ids)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(N,) which took part in an update."""
        return (self.outcome == Outcome.INLIER) | (self.outcome == Outcome.RESCUED)


@dataclass(frozen=True)
class SlamEstimate:
    """The pose of one frame.

    Attributes:
        index: Of the frame.
        previous: Index of the frame of the step before.
        pose: world_T_camera.
        prev_T_cur: Motion since the step before.
        status: How it came about.
        landmarks: All that were in the map before the frame, and those that begin at it.
        scale_sigma: Standard deviation of the logarithm of the scale that the map shares; NaN without landmarks.
        times: Milliseconds by stage.
    """

    index: int
    previous: int
    pose: GaussianPose
    prev_T_cur: GaussianPose
    status: Status
    landmarks: Landmarks = field(default_factory=Landmarks.none)
    scale_sigma: float = float("nan")
    times: dict[str, float] = field(default_factory=dict)
