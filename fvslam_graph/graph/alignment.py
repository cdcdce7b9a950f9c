"""A first alignment of a path with positions on Earth, some of which are wrong."""

from __future__ import annotations

from itertools import combinations

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.gates import chi2_gate

Array = NDArray[np.float64]

MAX_CANDIDATES = 30  # positions whose pairs are tried
MIN_INLIERS = 4
GATE = chi2_gate(0.999, 3)
SCALE_SIGMA = 0.05  # share of a length that the path may err by
MAX_HEADING_SIGMA = 0.1  # rad; a path that is longer than that against the noise of the positions tells the heading
ITERATIONS = 20  # of iteratively reweighted least squares


def align(path: Array, enu: Array, sigmas: Array, world_up: Array, up_sigma: float) -> gtsam.Pose3 | None:
    """Find enu_T_world by positions in both, whichever of them are wrong.

    Pairs of positions, with the direction up, each propose an alignment. The one that most positions agree with is
    improved by least squares with Cauchy's weights.

    Args:
        path: (N, 3) positions in the world, metres.
        enu: (N, 3) the same, east, north, up.
        sigmas: (N,) their deviations along an axis.
        world_up: (3,) which way is up in the world,
        up_sigma: and how well that is known, radians.

    Returns:
        None where the positions do not yet determine it.
    """
    if len(path) < MIN_INLIERS:
        return None
    up_weight = 1 / up_sigma**2
    chosen = np.unique(np.linspace(0, len(path) - 1, MAX_CANDIDATES).astype(int))
    best, least = None, np.inf
    for pair in combinations(chosen, 2):
        rows = list(pair)
        proposed = _fit(path[rows], enu[rows], 1 / sigmas[rows] ** 2, world_up, up_weight)
        cost = np.minimum(_chi2(proposed, path, enu, sigmas), GATE).sum()
        if cost < least:
            best, least = proposed, cost
    for _ in range(ITERATIONS):
        weights = 1 / (1 + _chi2(best, path, enu, sigmas) / 3) / sigmas**2
        best = _fit(path, enu, weights, world_up, up_weight)
    good = _chi2(best, path, enu, sigmas) < GATE
    if good.sum() < max(MIN_INLIERS, len(path) / 2 + 1):
        return None
    level = enu[good, :2] - enu[good, :2].mean(axis=0)
    information = ((level**2).sum(axis=1) / sigmas[good] ** 2).sum()
    return best if information > MAX_HEADING_SIGMA**-2 else None


def _fit(path: Array, enu: Array, weights: Array, world_up: Array, up_weight: float) -> gtsam.Pose3:
    """Weighted least squares of positions and the direction up."""
    share = weights / weights.sum()
    a, b = share @ path, share @ enu
    correlation = (enu - b).T @ (weights[:, None] * (path - a)) + up_weight * np.outer([0.0, 0.0, 1.0], world_up)
    rotation = gtsam.Rot3.ClosestTo(correlation)
    return gtsam.Pose3(rotation, b - rotation.rotate(a))


def _chi2(enu_T_world: gtsam.Pose3, path: Array, enu: Array, sigmas: Array) -> Array:
    """Squared distances (N,) in deviations of one axis; lengths of the path have a scale that errs."""
    away = enu - enu_T_world.transformFrom(path.T).T
    reach = ((path - path.mean(axis=0)) ** 2).sum(axis=1)
    chi2: Array = (away**2).sum(axis=1) / (sigmas**2 + SCALE_SIGMA**2 * reach)
    return chi2
