"""Inverse depths of points, each with its own error and with those that they share."""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import by_calibration
from fvslam_graph.core.quick import median

UNKNOWN = 10.0  # times the usual inverse depth: the deviation of one that is not known
TELLING = 2.0  # standard deviations of an inverse depth from zero, beyond which a point is not on the horizon
COMMON_ERRORS = 5  # that depths share, by what earlier motions erred: the most important ones


@dataclass(frozen=True)
class InverseDepths:
    """Inverse depths of points along the optical axis of a keyframe.

    Attributes:
        ids: (N,) of the tracks.
        values: (N,) 1/metres (1/baseline where the baseline has no scale yet).
        sigmas: (N,) standard deviations, each on its own.
        common: (N, S) how they err together, by the motions that triangulated them: what each of S independent errors
            of deviation 1 adds to them. The last five are those of the newest motion.
        J_calibration: (N, 2) how they change with the logarithm of the focal length and with k1.
    """

    ids: NDArray[np.int64]
    values: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    common: NDArray[np.float64]
    J_calibration: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def total_sigmas(self) -> NDArray[np.float64]:
        """(N,) standard deviations with what they err together."""
        total: NDArray[np.float64] = np.hypot(self.sigmas, np.linalg.norm(self.common, axis=1))
        return total

    @property
    def telling(self) -> NDArray[np.bool_]:
        """(N,) which points are not on the horizon, so that they tell how far the camera goes."""
        telling: NDArray[np.bool_] = self.values > TELLING * self.sigmas
        return telling

    @property
    def usual(self) -> float:
        """Root mean square without what noise adds, so that a horizon hardly counts; zero where there are none."""
        if not len(self):
            return 0.0
        weight = 1 / np.maximum(self.sigmas**2, 1e-18)
        square = float(weight @ self.values**2 - len(self)) / float(weight.sum())
        return math.sqrt(square) if square > 0 else median(self.values)

    @classmethod
    def none(cls) -> InverseDepths:
        """The depths of no points."""
        return cls.independent(np.empty(0, np.int64), np.empty(0), np.empty(0))

    @classmethod
    def independent(
        cls, ids: NDArray[np.int64], values: NDArray[np.float64], sigmas: NDArray[np.float64]
    ) -> InverseDepths:
        """Depths whose errors have nothing in common, whatever the calibration is."""
        return cls(ids, values, sigmas, np.zeros((len(ids), 0)), np.zeros((len(ids), 2)))

    def match(self, ids: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Where tracks `ids` and these depths are of the same points: indices into these, and into `ids`."""
        _, mine, theirs = np.intersect1d(self.ids, ids, assume_unique=True, return_indices=True)
        return mine, theirs

    def __getitem__(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> InverseDepths:
        return InverseDepths(
            self.ids[chosen], self.values[chosen], self.sigmas[chosen], self.common[chosen], self.J_calibration[chosen]
        )

    def of(self, ids: NDArray[np.int64]) -> InverseDepths:
        """The depths of tracks `ids`; those that are not known are as usual, within a large factor."""
        mine, theirs = self.match(ids)
        usual = self.usual
        values, sigmas = np.full(len(ids), usual), np.full(len(ids), UNKNOWN * usual)
        common, J_calibration = np.zeros((len(ids), self.common.shape[1])), np.zeros((len(ids), 2))
        values[theirs], sigmas[theirs], common[theirs] = self.values[mine], self.sigmas[mine], self.common[mine]
        J_calibration[theirs] = self.J_calibration[mine]
        return InverseDepths(ids, values, sigmas, common, J_calibration)

    def scaled(self, factor: float, J_calibration: NDArray[np.float64] | float = 0.0) -> InverseDepths:
        """The same points with all distances multiplied by `factor`, whose logarithm changes so (2,)."""
        changes = self.J_calibration - self.values[:, None] * J_calibration
        return InverseDepths(
            self.ids, self.values / factor, self.sigmas / factor, self.common / factor, changes / factor
        )

    def fused(self, other: InverseDepths) -> InverseDepths:
        """Both together; a point that both know gets the mean, weighted by information.

        The errors that the depths of either share have nothing in common.
        """
        ours = self.compressed()
        mine, theirs = ours.match(other.ids)
        information = ours.sigmas[mine] ** -2 + other.sigmas[theirs] ** -2
        weight = ours.sigmas[mine] ** -2 / information
        only_mine, only_theirs = np.ones(len(ours), bool), np.ones(len(other), bool)
        only_mine[mine], only_theirs[theirs] = False, False
        size = ours.common.shape[1]
        common = np.zeros((len(ours) + only_theirs.sum(), size + other.common.shape[1]))
        both, first = slice(0, len(mine)), slice(len(mine), len(ours))
        common[both, :size] = weight[:, None] * ours.common[mine]
        common[both, size:] = (1 - weight)[:, None] * other.common[theirs]
        common[first, :size] = ours.common[only_mine]
        common[len(ours) :, size:] = other.common[only_theirs]
        mean = weight * ours.values[mine] + (1 - weight) * other.values[theirs]
        J_mean = weight[:, None] * ours.J_calibration[mine] + (1 - weight)[:, None] * other.J_calibration[theirs]
        return InverseDepths(
            np.concatenate([ours.ids[mine], ours.ids[only_mine], other.ids[only_theirs]]),
            np.concatenate([mean, ours.values[only_mine], other.values[only_theirs]]),
            np.concatenate([information**-0.5, ours.sigmas[only_mine], other.sigmas[only_theirs]]),
            common,
            np.concatenate([J_mean, ours.J_calibration[only_mine], other.J_calibration[only_theirs]]),
        )

    def compressed(self) -> InverseDepths:
        """The same with the most important of the errors in common; the others become each depth's own."""
        if self.common.shape[1] <= COMMON_ERRORS:
            return self
        relative = self.common / self.sigmas[:, None]
        _, axes = np.linalg.eigh(relative.T @ relative)
        turned = self.common @ axes[:, ::-1]
        sigmas = np.hypot(self.sigmas, np.linalg.norm(turned[:, COMMON_ERRORS:], axis=1))
        return InverseDepths(self.ids, self.values, sigmas, turned[:, :COMMON_ERRORS], self.J_calibration)

    def seen_from(
        self,
        rays: NDArray[np.float64],
        keyframe_T_new: gtsam.Pose3,
        motion_errors: NDArray[np.float64] | None = None,
        motion_J_calibration: NDArray[np.float64] | None = None,
    ) -> InverseDepths:
        """The same points' inverse depths in a new keyframe; points that are not in front of it are dropped.

        Args:
            rays: (N, 3) viewing rays in the old keyframe, z = 1.
            keyframe_T_new: Pose of the new keyframe in the old one, metres.
            motion_errors: (5, 5) what each of the last five errors in common adds to its rotation and to the direction
                of its translation, in the plane of gtsam.Unit3.basis; None where they add nothing.
            motion_J_calibration: (6, 2) how it changes with the calibration, in its tangent; None where it does not.
        """
        # Depth in the new camera is (ray / value - t) . z, z being its optical axis in the old one.
        R, t = keyframe_T_new.rotation().matrix(), keyframe_T_new.translation()
        axis = R[:, 2]
        along = rays @ axis
        remaining = along - self.values * float(axis @ t)
        kept = (remaining > 0.05 * along) & (self.values > 0)
        rays, along, remaining, known = rays[kept], along[kept], remaining[kept], self.values[kept]
        # d(value / (along - value a)) / d value = along / remaining^2
        J_value = along / remaining**2
        J_remaining = -known / remaining**2
        J_rotation = np.zeros((len(known), 3))  # of what remains: the axis turns by R (w x z)
        J_rotation[:, 0] = known * float(t @ R[:, 1]) - rays @ R[:, 1]
        J_rotation[:, 1] = rays @ R[:, 0] - known * float(t @ R[:, 0])
        common, J_calibration = J_value[:, None] * self.common[kept], J_value[:, None] * self.J_calibration[kept]
        if motion_errors is not None:
            across = float(np.linalg.norm(t)) * (axis @ gtsam.Unit3(t).basis())
            J_motion = np.hstack([J_rotation, -known[:, None] * across])
            common[:, -5:] += J_remaining[:, None] * (J_motion @ motion_errors)
        J_seen = by_calibration(rays, axis[:2])  # of what remains
        if motion_J_calibration is not None:
            J_seen += J_rotation @ motion_J_calibration[:3] - known[:, None] * motion_J_calibration[5]
        J_calibration += J_remaining[:, None] * J_seen
        return InverseDepths(self.ids[kept], known / remaining, J_value * self.sigmas[kept], common, J_calibration)


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
