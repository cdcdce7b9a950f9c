"""Inverse depths of points, each with its own error and with those that they share."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.quick import median

UNKNOWN = 10.0  # times the usual inverse depth: the deviation of one that is not known
COMMON_ERRORS = 5  # errors that depths share: those of rotation and direction


@dataclass(frozen=True)
class InverseDepths:
    """Inverse depths of points along the optical axis of a keyframe.

    Attributes:
        ids: (N,) of the tracks.
        values: (N,) 1/metres (1/baseline where the baseline has no scale yet).
        sigmas: (N,) standard deviations, each on its own.
        common: (N, 5) how they err together, by the rotation and direction of the motion that triangulated them: what
            each of five independent errors of deviation 1 adds to them.
    """

    ids: NDArray[np.int64]
    values: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    common: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def total_sigmas(self) -> NDArray[np.float64]:
        """(N,) standard deviations with what they err together."""
        total: NDArray[np.float64] = np.hypot(self.sigmas, np.linalg.norm(self.common, axis=1))
        return total

    @classmethod
    def none(cls) -> InverseDepths:
        """The depths of no points."""
        return cls.independent(np.empty(0, np.int64), np.empty(0), np.empty(0))

    @classmethod
    def independent(
        cls, ids: NDArray[np.int64], values: NDArray[np.float64], sigmas: NDArray[np.float64]
    ) -> InverseDepths:
        """Depths whose errors have nothing in common."""
        return cls(ids, values, sigmas, np.zeros((len(ids), COMMON_ERRORS)))

    def match(self, ids: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Where tracks `ids` and these depths are of the same points: indices into these, and into `ids`."""
        _, mine, theirs = np.intersect1d(self.ids, ids, assume_unique=True, return_indices=True)
        return mine, theirs

    def __getitem__(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> InverseDepths:
        return InverseDepths(self.ids[chosen], self.values[chosen], self.sigmas[chosen], self.common[chosen])

    def of(self, ids: NDArray[np.int64]) -> InverseDepths:
        """The depths of tracks `ids`; those that are not known are as usual, within a large factor."""
        mine, theirs = self.match(ids)
        usual = median(self.values) if len(self) else 0.0
        depths = InverseDepths.independent(ids, np.full(len(ids), usual), np.full(len(ids), UNKNOWN * usual))
        depths.values[theirs], depths.sigmas[theirs] = self.values[mine], self.sigmas[mine]
        depths.common[theirs] = self.common[mine]
        return depths

    def scaled(self, factor: float) -> InverseDepths:
        """The same points with all distances multiplied by `factor`."""
        return InverseDepths(self.ids, self.values / factor, self.sigmas / factor, self.common / factor)

    def fused(self, other: InverseDepths) -> InverseDepths:
        """Both together; a point that both know gets the mean, weighted by information.

        What the depths of one motion share is averaged out by those of others just as what each has on its own.
        """
        mine, theirs = self.match(other.ids)
        information = self.sigmas[mine] ** -2 + other.sigmas[theirs] ** -2
        mean = (self.values[mine] * self.sigmas[mine] ** -2 + other.values[theirs] * other.sigmas[theirs] ** -2) / (
            information
        )
        common = other.common[theirs] * (information**-0.5 / other.sigmas[theirs])[:, None]
        only_mine = np.setdiff1d(np.arange(len(self)), mine)
        only_theirs = np.setdiff1d(np.arange(len(other)), theirs)
        return InverseDepths(
            np.concatenate([self.ids[mine], self.ids[only_mine], other.ids[only_theirs]]),
            np.concatenate([mean, self.values[only_mine], other.values[only_theirs]]),
            np.concatenate([information**-0.5, self.sigmas[only_mine], other.sigmas[only_theirs]]),
            np.vstack([common, self.common[only_mine], other.common[only_theirs]]),
        )

    def seen_from(self, rays: NDArray[np.float64], keyframe_T_new: gtsam.Pose3) -> InverseDepths:
        """The same points' inverse depths in a new keyframe; points that are not in front of it are dropped.

        Args:
            rays: (N, 3) viewing rays in the old keyframe, z = 1.
            keyframe_T_new: Pose of the new keyframe in the old one, metres.
        """
        # Depth in the new camera is (ray / value - t) . z, z being its optical axis in the old one.
        axis = keyframe_T_new.rotation().matrix()[:, 2]
        along = rays @ axis
        remaining = along - self.values * float(axis @ keyframe_T_new.translation())
        values = self.values / remaining
        kept = (remaining > 0.05 * along) & (values > 0)
        # d(value / (along - value a)) / d value = along / remaining^2
        J_value = along[kept] / remaining[kept] ** 2
        return InverseDepths(
            self.ids[kept], values[kept], J_value * self.sigmas[kept], J_value[:, None] * self.common[kept]
        )


@dataclass(frozen=True)
class MetricMap:
    """Points of known depth in a keyframe.

    Attributes:
        depths: Their inverse depths, 1/metres.
        variance: Of the logarithm of the scale that all depths share.
    """

    depths: InverseDepths
    variance: float

    def __len__(self) -> int:
        return len(self.depths)

    @classmethod
    def empty(cls) -> MetricMap:
        """A map without points."""
        return cls(InverseDepths.none(), 0.0)
