"""Which point of a keyframe is which point of the current one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image


@dataclass(frozen=True)
class Tracks:
    """N points seen in a keyframe and in the current one.

    Attributes:
        ids: (N,) int64, the same number for the same point as long as it is followed.
        keyframe: (N, 2) pixels in the keyframe.
        current: (N, 2) pixels in the current image.
        covariances: (N, 2, 2) of the displacements, in variances of one on a corner, along either axis.
        alignment_bias: (N, 2, 2, 2) pixels by which displacements err where patches are deformed, see
            `features.alignment_bias`; None where they do not, or where that is not known.
        turn: Radians, from x to y, by which patches were turned before they were aligned.
    """

    ids: NDArray[np.int64]
    keyframe: NDArray[np.float64]
    current: NDArray[np.float64]
    covariances: NDArray[np.float64]
    alignment_bias: NDArray[np.float64] | None = None
    turn: float = 0.0

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Tracks:
        bias = None if self.alignment_bias is None else self.alignment_bias[chosen]
        return Tracks(
            self.ids[chosen], self.keyframe[chosen], self.current[chosen], self.covariances[chosen], bias, self.turn
        )

    def joined(self, other: Tracks) -> Tracks:
        """These tracks and others of the same image."""
        bias = None
        if self.alignment_bias is not None and other.alignment_bias is not None:
            bias = np.concatenate([self.alignment_bias, other.alignment_bias])
        return Tracks(
            np.concatenate([self.ids, other.ids]),
            np.concatenate([self.keyframe, other.keyframe]),
            np.concatenate([self.current, other.current]),
            np.concatenate([self.covariances, other.covariances]),
            bias,
            self.turn,
        )

    @classmethod
    def none(cls) -> Tracks:
        """No tracks at all."""
        return cls.alike(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2)))

    @classmethod
    def alike(cls, ids: NDArray[np.int64], keyframe: NDArray[np.float64], current: NDArray[np.float64]) -> Tracks:
        """Tracks of corners, which all err by as much."""
        return cls(ids, keyframe, current, np.tile(np.eye(2), (len(ids), 1, 1)))


def variances_along(axes: NDArray[np.float64], covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variances (N,) along axes (N, 2), times their squared lengths, of covariances (N, 2, 2)."""
    x, y = axes.T
    variances: NDArray[np.float64] = (
        covariances[:, 0, 0] * x * x + 2 * covariances[:, 0, 1] * x * y + covariances[:, 1, 1] * y * y
    )
    return variances


class FeatureTracker(Protocol):
    """Finds the points of a keyframe again in later images; that of another package is made with `FeatureSettings`.

    Where a keyframe is lost, a shallow copy of its tracker is kept, so that no array may be changed in place.
    """

    def track(self, image: Image) -> Tracks:
        """The points of the keyframe that are found in `image`, (H, W) uint8."""

    def set_keyframe(self, image: Image, kept: Tracks) -> Tracks:
        """Make `image` the keyframe: its points, the kept tracks and new corners, are returned."""
