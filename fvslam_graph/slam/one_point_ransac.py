"""Which matches agree: RANSAC whose hypotheses take a single match, since the filter's prior tells the rest.

Source: Civera, Grasa, Davison, Montiel, "1-point RANSAC for extended Kalman filtering", J. Field Robotics 27(5), 2010;
the local optimisation is that of Chum, Matas, Kittler, "Locally optimized RANSAC", DAGM 2003.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.slam.covariances import innovation_covariance, inverse_root
from fvslam_graph.slam.inverse_depth import Array
from fvslam_graph.slam.measurement import PIXEL_GATE, Prediction, predict_pixels

RANSAC_CONFIDENCE = 0.99  # of having drawn one right match
MAX_SAMPLE = 40  # matches, drawn of more, that hypotheses are tested on: enough to tell a right one
KNOWN = 2.0  # pixels; a match that is expected better than this has a whole vote


def low_innovation_inliers(
    prediction: Prediction, pixels: Array, found: NDArray[np.bool_], slack: float, rng: np.random.Generator
) -> tuple[NDArray[np.bool_], float]:
    """The largest set of matches in which each lies where the others lead to.

    A hypothesis takes one match as right. Those that it does not rule out are then held against each other (the local
    optimisation), since one match leaves some of the motion open, such as the roll. Hypotheses compete on a sample of
    the matches. All matches are then held against the best set. Where it leads far from what was expected, they are
    checked once more, linearised there.

    Args:
        prediction: Of N landmarks.
        pixels: (N, 2) where they were matched.
        found: (N,) which were matched.
        slack: Pixels by which the linearisation may be off.
        rng: Draws the matches.

    Returns:
        (N,) bool, and the sum of votes: a match that could hardly have failed, as the depth of its landmark is open,
        counts for little.
    """
    if not found.any():
        return found.copy(), 0.0
    state, model = prediction.state, prediction.model
    candidates = np.flatnonzero(found)
    HP, S = innovation_covariance(prediction.jacobian(found), state.covariance, model.sigma)
    off = (pixels - prediction.pixels)[candidates]

    sample = rng.permutation(len(candidates))[:MAX_SAMPLE]
    rows = (2 * sample[:, None] + (0, 1)).ravel()
    chosen, votes = _best_set(off[sample], S[np.ix_(rows, rows)], slack)
    best = np.zeros(len(candidates), bool)
    best[sample[chosen]] = True
    if len(sample) < len(candidates):
        best, votes = _agree(best, off, S, slack)
    # What is left out of a linear model is quadratic in the angle by which the view differs from the expected one.
    if best.any() and (off[best] ** 2).sum(axis=1).max() > slack * model.camera.fx / 4:
        rows = np.repeat(best, 2)
        whiten = inverse_root(S[np.ix_(rows, rows)])
        error = HP[rows].T @ (whiten.T @ (whiten @ off[best].ravel()))
        there = predict_pixels(state.retract(error), model)
        jacobian = there.jacobian(found)
        off = (pixels - there.pixels)[candidates] + (jacobian @ error).reshape(-1, 2)
        _, S = innovation_covariance(jacobian, state.covariance, model.sigma)
        best, votes = _agree(best, off, S, slack)
    inliers = found.copy()
    inliers[candidates] = best
    return inliers, votes


def _best_set(off: Array, S: Array, slack: float) -> tuple[NDArray[np.bool_], float]:
    """Which of N matches are the best hypothesis, with the sum of their votes; arguments as for `_agree`.

    Matches are held against the best set as long as this wins votes: wrong ones among those not ruled out lead the
    others astray, and the few that agree nevertheless lead to the rest.
    """
    chosen, votes, needed = np.zeros(len(off), bool), 0.0, len(off)
    for tried in range(len(off)):
        if tried >= needed:
            break
        agree, sum_of_votes = _agree(_possible(tried, off, S, slack), off, S, slack)
        if sum_of_votes > votes:
            chosen, votes = agree, sum_of_votes
            miss = 1 - chosen.sum() / len(off)
            needed = min(needed, math.ceil(math.log(1 - RANSAC_CONFIDENCE) / math.log(miss))) if miss > 0 else 0
    while (agreed := _agree(chosen, off, S, slack))[1] > votes:
        chosen, votes = agreed
    return chosen, votes


def _possible(taken: int, off: Array, S: Array, slack: float) -> NDArray[np.bool_]:
    """Which of N matches a single one that is taken as right does not rule out; arguments as for `_agree`."""
    cross = S.reshape(len(off), 2, len(off), 2)[:, :, taken]
    gain = cross @ np.linalg.inv(cross[taken])
    residual, covariance = off - gain @ off[taken], _blocks(S) - gain @ cross.mT
    residual[taken], covariance[taken] = off[taken], cross[taken]
    return _near(residual, covariance, slack)


def _agree(chosen: NDArray[np.bool_], off: Array, S: Array, slack: float) -> tuple[NDArray[np.bool_], float]:
    """Which of N matches lie where the chosen ones, each of these without itself, lead to; and the sum of their votes.

    Args:
        chosen: (N,) bool.
        off: (N, 2) pixels from where they were expected.
        S: (2N, 2N) its covariance.
        slack: Pixels of tolerance.
    """
    if not chosen.any():
        return chosen, 0.0
    inside, outside = np.repeat(chosen, 2), np.repeat(~chosen, 2)
    residual, covariance = np.empty_like(off), np.empty((len(chosen), 2, 2))
    # The inverse of the Cholesky factor makes the chosen ones independent of each other.
    whiten = inverse_root(S[np.ix_(inside, inside)])
    white = whiten @ off[chosen].ravel()
    # Each chosen one given the rest of them (leave one out), by the inverse of its block of the information.
    rows = whiten.T.reshape(-1, 2, len(white))
    covariance[chosen] = np.linalg.inv(rows @ rows.mT)
    residual[chosen] = (covariance[chosen] @ (rows @ white)[:, :, None])[:, :, 0]
    # The others given the chosen ones.
    rows = (S[np.ix_(outside, inside)] @ whiten.T).reshape(-1, 2, len(white))
    covariance[~chosen] = _blocks(S)[~chosen] - rows @ rows.mT
    residual[~chosen] = off[~chosen] - rows @ white

    agree = _near(residual, covariance, slack)
    votes = KNOWN**2 / np.sqrt(np.linalg.det(covariance[agree] + KNOWN**2 * np.eye(2)))
    return agree, float(votes.sum())


def _near(residual: Array, covariance: Array, slack: float) -> NDArray[np.bool_]:
    """Which residuals (N, 2) of covariance (N, 2, 2) are within the gate, with pixels of tolerance."""
    (x, y), tolerance = residual.T, slack**2 / PIXEL_GATE
    xx, yy, xy = covariance[:, 0, 0] + tolerance, covariance[:, 1, 1] + tolerance, covariance[:, 0, 1]
    near: NDArray[np.bool_] = yy * x**2 - 2 * xy * x * y + xx * y**2 < PIXEL_GATE * (xx * yy - xy**2)
    return near


def _blocks(matrix: NDArray[Any]) -> Array:
    """The (N, 2, 2) blocks on the diagonal of a matrix (2N, 2N)."""
    each = np.arange(len(matrix) // 2)
    blocks: Array = matrix.reshape(len(each), 2, len(each), 2)[each, :, each]
    return blocks
