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
    """

    mean: float
    low: float
    high: float
    dof: float
    count: int
    below: float


def nees(
    errors: NDArray[np.float64], covariances: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """e^T P^-1 e of pose errors, and their degrees of freedom.

    A covariance of lower rank makes no statement about some direction, as where the scale of a monocular step is
    unknown; the error along it is left out, and the degrees of freedom are the rank.

    Args:
        errors: (N, 6) rotation (rad), translation (m).
        covariances: (N, 6, 6) of the same tangent.

    Returns:
        (N,) NEES and (N,) ranks.
    """
    # Radians and metres are made comparable, so that the rank does not depend on the units. One number for each of
    # the two blocks leaves a direction of translation that has no variance what it is.
    variances = np.diagonal(covariances, axis1=1, axis2=2).reshape(-1, 2, 3).sum(axis=2)
    scales = np.repeat(np.sqrt(np.where(variances > 0, variances, 1.0)), 3, axis=1)
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


def consistency(errors: NDArray[np.float64], covariances: NDArray[np.float64], level: float = 0.95) -> Consistency:
    """Summary of the NEES of N > 0 pose errors (N, 6) with covariances (N, 6, 6), and the band of this level."""
    from scipy.stats import chi2

    values, dof = nees(errors, covariances)
    low, high = nees_band(float(dof.mean()), len(values), level)
    below = np.mean(values <= chi2.ppf(0.95, dof))
    return Consistency(float(values.mean()), low, high, float(dof.mean()), len(values), float(below))


def relative_errors(
    pairs: TrajectoryPairs, relatives: Relatives, scale: float = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Errors of estimated relative motions against a reference.

    Args:
        pairs: Says which frames have a reference; its estimate must be all frames that `relatives` is about.
        relatives: Motions that have a covariance other than zero are compared, where both of their frames have a
            reference.
        scale: Factor on the estimated translations (Sim3 alignment).

    Returns:
        (K, 6) errors Logmap(estimate^-1 reference), rotation (rad) and translation (m); their (K, 6, 6) covariances.
    """
    count = len(relatives.previous)
    row = np.full(count, -1)
    row[pairs.indices] = np.arange(len(pairs.indices))
    described = np.isfinite(relatives.covariances).all(axis=(1, 2)) & relatives.covariances.any(axis=(1, 2))
    frames = np.flatnonzero(described & (row >= 0) & (row[relatives.previous] >= 0))
    metric = np.repeat([1.0, scale], 3)
    errors = np.empty((len(frames), 6))
    for error, frame in zip(errors, frames, strict=True):
        matrix = relatives.prev_T_cur[frame]
        estimate = gtsam.Pose3(gtsam.Rot3(matrix[:3, :3]), scale * matrix[:3, 3])
        start, end = row[relatives.previous[frame]], row[frame]
        reference = pairs.reference.poses[start].between(pairs.reference.poses[end])
        error[:] = gtsam.Pose3.Logmap(estimate.between(reference))
    return errors, relatives.covariances[frames] * np.outer(metric, metric)
