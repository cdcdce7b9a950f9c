"""Which matches agree: RANSAC whose hypotheses take a single match, since the filter's prior tells the rest.

Source: Civera, Grasa, Davison, Montiel, "1-point RANSAC for extended Kalman filtering", J. Field Robotics 27(5), 2010;
the local optimisation is that of Chum, Matas, Kittler, "Locally optimized RANSAC", DAGM 2003.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.camera import Camera
from fvslam_graph.slam.landmarks import Array
from fvslam_graph.slam.measurement import Prediction, project
from fvslam_graph.slam.motion import travelled
from fvslam_graph.slam.state import VELOCITY, State

CONFIDENCE = 0.99  # of having drawn one right match
MAX_HYPOTHESES = 50
OPTIMISATIONS = 2  # with the matches that agree, of a hypothesis that may be the best
KNOWN = 2.0  # pixels; a landmark that is known better than this has a whole vote
GATE = 9.210  # 99 % quantile of the chi-square distribution with two degrees of freedom


def low_innovation_inliers(
    state: State,
    prediction: Prediction,
    pixels: Array,
    found: NDArray[np.bool_],
    seconds: float,
    camera: Camera,
    sigma: float,
    threshold: float,
    rng: np.random.Generator,
) -> tuple[NDArray[np.bool_], float]:
    """The largest set of matches that one motion predicts.

    A hypothesis is the state updated by one match. The matches that it does not rule out update it once more (the local
    optimisation), since one match leaves some of the motion open, such as the roll. A match agrees that lies within
    `threshold` pixels of where the outcome's motion leads its landmark; for a landmark whose depth is open, that is a
    strip along its epipolar line. As much would agree with such a strip by chance, its vote counts for less.

    Args:
        state: Predicted.
        prediction: Of its N landmarks.
        pixels: (N, 2) where they were matched.
        found: (N,) which were matched.
        seconds: Since the previous frame.
        camera: Undistorted.
        sigma: Of a matched pixel along each axis.
        threshold: Pixels between a match and its prediction.
        rng: Draws the matches.

    Returns:
        (N,) bool, and the sum of votes: how many matches of landmarks at known depths would tell as much.
    """
    candidates = np.flatnonzero(found)
    best = np.zeros(len(found), bool)
    innovation = (pixels - prediction.pixels)[candidates]
    jacobian = prediction.jacobian(found)
    product = jacobian @ state.covariance
    spread = jacobian @ product.T + sigma**2 * np.eye(len(product))
    own = prediction.landmark_spread(state)
    strip = np.linalg.inv(own + threshold**2 / GATE * np.eye(2))
    votes = KNOWN**2 / np.sqrt(np.linalg.det(own + KNOWN**2 * np.eye(2)))

    def agreeing(chosen: NDArray[np.intp]) -> NDArray[np.bool_]:
        """What the state updated by the chosen of the candidates predicts."""
        rows = (2 * chosen[:, None] + (0, 1)).ravel()
        error = product[rows].T @ np.linalg.solve(spread[np.ix_(rows, rows)], innovation[chosen].ravel())
        prev_T_cur, _ = travelled(state.velocity + error[VELOCITY], seconds)
        expected, depths = project(state, prev_T_cur, camera)
        return found & (depths > 0) & (_squares(pixels - expected, strip) < GATE)

    needed = min(len(candidates), MAX_HYPOTHESES)
    for tried, chosen in enumerate(rng.permutation(len(candidates))):
        if tried >= needed:
            break
        possible = _compatible(chosen, innovation, spread)
        agree = agreeing(np.flatnonzero(possible))
        for _ in range(OPTIMISATIONS):
            if agree.any() and votes[agree].sum() >= votes[best].sum():
                agree = agreeing(np.flatnonzero(agree[candidates]))
        if votes[agree].sum() > votes[best].sum():
            best = agree
            miss = 1 - best.sum() / len(candidates)
            needed = min(needed, math.ceil(math.log(1 - CONFIDENCE) / math.log(miss))) if miss > 0 else 0
    return best, float(votes[best].sum())


def _compatible(chosen: int, innovation: Array, spread: Array) -> NDArray[np.bool_]:
    """Which matches (N,) lie where they are expected once the chosen one is taken as right.

    Args:
        chosen: A row of the following.
        innovation: (N, 2) pixels.
        spread: (2N, 2N) its covariance.
    """
    rows = slice(2 * chosen, 2 * chosen + 2)
    gain = np.linalg.solve(spread[rows, rows], spread[rows]).T
    residual = innovation - (gain @ innovation[chosen]).reshape(-1, 2)
    each = np.arange(len(innovation))
    own = (spread - gain @ spread[rows]).reshape(len(each), 2, len(each), 2)[each, :, each]
    own[chosen], residual[chosen] = np.eye(2), 0.0
    return _squares(residual, np.linalg.inv(own)) < GATE


def _squares(vectors: Array, information: NDArray[np.floating[Any]]) -> Array:
    """Squared lengths (N,) of vectors (N, 2) in the metrics (N, 2, 2)."""
    squares: Array = np.einsum("ni,nij,nj->n", vectors, information, vectors)
    return squares
