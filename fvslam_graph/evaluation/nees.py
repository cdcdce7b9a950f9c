"""Whether covariances are consistent: the normalised estimation error squared (NEES).

Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 5.4.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.evaluation.association import TrajectoryPairs
from fvslam_graph.runs.results import Relatives

MAX_DIRECTION_SIGMA = 0.3  # rad; above, a direction is no linear matter
_SINGULAR = 1e-12  # ratio of eigenvalues below which a covariance says nothing about a direction


@dataclass(frozen=True)
class Consistency:
    """NEES over many estimates; consistent where `mean` lies in the band.

    Attributes:
        mean: Mean NEES.
        low: Lower end of the band in which the mean of as many consistent estimates lies, by default in 95 % of cases.
        high: Upper end of it.
        dof: Mean degrees of freedom, the expected NEES.
        count: How many estimates.
        below: Fraction of estimates below the 95 % quantile of their chi-square distribution; 0.95 is consistent.
        added: What the noise of the reference alone adds to the mean.
        judged: Whether the reference is good enough to judge the covariances.
    """

    mean: float
    low: float
    high: float
    dof: float
    count: int
    below: float
    added: float = 0.0
    judged: bool = True


@dataclass(frozen=True)
class MotionErrors:
    """Errors of K estimated relative motions that have a covariance and a reference.

    Attributes:
        errors: (K, 6) Logmap(estimate^-1 reference), rotation (rad) and translation (m).
        covariances: (K, 6, 6) of the estimates.
        translations: (K, 3) of the estimates, in the axes of where they lead to, metres.
    """

    errors: NDArray[np.float64]
    covariances: NDArray[np.float64]
    translations: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.errors)

    @property
    def lengths(self) -> NDArray[np.float64]:
        """(K,) metres."""
        lengths: NDArray[np.float64] = np.linalg.norm(self.translations, axis=1)
        return lengths

    def directions(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Which motions have a known direction, their errors (D, 2) across it, rad, and covariances (D, 2, 2)."""
        length = self.lengths
        moving = np.flatnonzero(length > 0)
        ours = self.translations[moving] / length[moving, None]
        least = np.eye(3)[np.argmin(np.abs(ours), axis=1)]
        across = np.stack([first := np.cross(ours, least), np.cross(ours, first)], axis=1)
        across /= np.linalg.norm(across, axis=2, keepdims=True)
        theirs = self.translations[moving] + self.errors[moving, 3:]
        norms = np.linalg.norm(theirs, axis=1, keepdims=True)
        errors = (across @ (theirs / np.where(norms > 0, norms, 1.0))[:, :, None])[:, :, 0]
        turned = across @ self.covariances[moving, 3:, 3:] @ across.swapaxes(1, 2)
        covariances = turned / (length[moving] ** 2)[:, None, None]
        known = np.trace(covariances, axis1=1, axis2=2) < MAX_DIRECTION_SIGMA**2
        return moving[known], errors[known], covariances[known]


def nees(
    errors: NDArray[np.float64], covariances: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """e^T P^-1 e of pose errors, and their degrees of freedom.

    A covariance of lower rank makes no statement about some direction, as where the scale of a monocular step is
    unknown; the error along it is left out, and the degrees of freedom are the rank.

    Args:
        errors: (N, 6) rotation (rad), translation (m), or (N, D), D < 6, all of one unit.
        covariances: (N, 6, 6) or (N, D, D) of the same tangent.

    Returns:
        (N,) NEES and (N,) ranks.
    """
    # Radians and metres are made comparable, so that the rank does not depend on the units. One number for each of
    # the two blocks leaves a direction of translation that has no variance what it is.
    block = min(errors.shape[1], 3)
    variances = np.diagonal(covariances, axis1=1, axis2=2).reshape(len(errors), -1, block).sum(axis=2)
    scales = np.repeat(np.sqrt(np.where(variances > 0, variances, 1.0)), block, axis=1)
    values, vectors = np.linalg.eigh(covariances / (scales[:, :, None] * scales[:, None, :]))
    known = values > _SINGULAR * values[:, -1:]
    parts = np.einsum("nij,ni->nj", vectors, errors / scales)
    squares = np.where(known, parts**2 / np.where(known, values, 1.0), 0.0)
    return squares.sum(axis=1), known.sum(axis=1)


def nees_band(dof: float, count: int, level: float = 0.95) -> tuple[float, float]:
    """In which the mean NEES of `count` independent, consistent estimates lies with probability `level`."""
    from scipy.stats import chi2

    low, high = chi2.ppf([(1 - level) / 2, (1 + level) / 2], dof * count) / count
    return float(low), float(high)


def average_nees(runs: NDArray[np.float64], dof: float = 6) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """Average over R Monte-Carlo runs of N steps, `runs` (R, N): (N,) per step, and the 95 % band of each of them."""
    return runs.mean(axis=0), nees_band(dof, len(runs))


def consistency(
    errors: NDArray[np.float64],
    covariances: NDArray[np.float64],
    noise: NDArray[np.float64] | None = None,
    level: float = 0.95,
) -> Consistency:
    """Summary of the NEES of N > 0 errors.

    The reference does not judge where its own noise would double the mean of consistent estimates, unless that is in
    the band, or below, nonetheless.

    Args:
        errors, covariances: As for `nees`.
        noise: (N, 6) or (N, D) standard deviations of the reference along the same axes; none if not given.
        level: Of the band.
    """
    from scipy.stats import chi2

    values, dof = nees(errors, covariances)
    low, high = nees_band(float(dof.mean()), len(values), level)
    below = np.mean(values <= chi2.ppf(0.95, dof))
    axes = np.eye(errors.shape[1])
    added = 0.0 if noise is None else sum(float(nees(noise * axis, covariances)[0].mean()) for axis in axes)
    mean, expected = float(values.mean()), float(dof.mean())
    judged = mean <= high or added < expected
    return Consistency(mean, low, high, expected, len(values), float(below), added, judged)


def relative_errors(pairs: TrajectoryPairs, relatives: Relatives, scale: float = 1.0) -> MotionErrors:
    """Errors of estimated relative motions against a reference.

    Args:
        pairs: Says which frames have a reference; its estimate must be all frames that `relatives` is about.
        relatives: Motions that have a covariance other than zero are compared, where both of their frames have a
            reference.
        scale: Factor on the estimated translations (Sim3 alignment).
    """
    count = len(relatives.previous)
    row = np.full(count, -1)
    row[pairs.indices] = np.arange(len(pairs.indices))
    described = np.isfinite(relatives.covariances).all(axis=(1, 2)) & relatives.covariances.any(axis=(1, 2))
    frames = np.flatnonzero(described & (row >= 0) & (row[relatives.previous] >= 0))
    metric = np.repeat([1.0, scale], 3)
    errors, translations = np.empty((len(frames), 6)), np.empty((len(frames), 3))
    for error, translation, frame in zip(errors, translations, frames, strict=True):
        matrix = relatives.prev_T_cur[frame]
        estimate = gtsam.Pose3(gtsam.Rot3(matrix[:3, :3]), scale * matrix[:3, 3])
        start, end = row[relatives.previous[frame]], row[frame]
        reference = pairs.reference.poses[start].between(pairs.reference.poses[end])
        error[:] = gtsam.Pose3.Logmap(estimate.between(reference))
        translation[:] = estimate.rotation().unrotate(estimate.translation())
    return MotionErrors(errors, relatives.covariances[frames] * np.outer(metric, metric), translations)
