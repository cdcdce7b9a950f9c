"""Inverse depths of tracks: triangulated from two views, and carried from one keyframe to the next."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.gaussian_pose import LogScale, square_root
from fvslam_graph.core.inverse_depths import InverseDepths
from fvslam_graph.core.quick import median
from fvslam_graph.core.tracks import variances_along
from fvslam_graph.vo.epipolar import MatchedRays

PIXEL_NOISE = 0.3  # pixels, of a displacement along each axis, where no motion has told it
GROUND_REACH = 20.0  # heights; a guess at where something stands in front of the ground, for a camera above it,
MIN_COMMON = 10  # tracks of known depth that tell a scale
RATIO_ITERATIONS, CONVERGED = 10, 0.01  # at most, and deviations of a step after which nothing changes
UNKNOWN_DEPTH = 10.0  # and at how far away things are for one whose height is unknown, metres


def triangulate(
    ids: NDArray[np.int64],
    matched: MatchedRays,
    rotation: gtsam.Rot3,
    baseline: NDArray[np.float64],
    noise: float = PIXEL_NOISE,
    covariance: NDArray[np.float64] | None = None,
) -> InverseDepths:
    """Inverse depths in the previous camera of points seen in two views; they may come out negative.

    Solves y x (x - rho b) = 0 for rho by least squares, with x the ray in the previous camera, y the current ray
    rotated into it and b the baseline.

    Args:
        ids: (N,) of the tracks.
        matched: (N,) their rays in both views.
        rotation: prev_R_cur.
        baseline: (3,) from the previous camera to the current one, in the previous; its length is the unit of depth.
        noise: Pixels, standard deviation of a track's displacement along each axis.
        covariance: (5, 5) of rotation and direction, as in RelativePose; without it, they are exact. Depths err
            together by its `square_root`.
    """
    previous, focal, covariances = matched.previous, matched.focal, matched.covariances
    rotated = matched.current @ rotation.matrix().T
    across = rotated @ gtsam.SO3.Hat(baseline)  # rotated x baseline
    square, along = np.maximum((across**2).sum(axis=1), 1e-18), (rotated * previous).sum(axis=1)
    values = ((rotated**2).sum(axis=1) * (previous @ baseline) - along * (rotated @ baseline)) / square
    # How fast the image of the point moves along its epipolar line when rho changes.
    seen = previous - values[:, None] * baseline
    turned, step = seen @ rotation.matrix(), rotation.unrotate(baseline)
    line = (step[2] * turned[:, :2] - step[:2] * turned[:, 2:]) / turned[:, 2:] ** 2
    speed = np.maximum(np.linalg.norm(line, axis=1), 1e-9)
    sigmas = noise / (focal * speed)
    if covariances is not None:
        sigmas *= np.sqrt(variances_along(line, covariances)) / speed
    if covariance is None:
        return InverseDepths.independent(ids, values, sigmas)
    # For y = R (1 + [w]x) y0 and b + |b| B d the cross product above changes by (R w x y) x seen - rho y x (|b| B d).
    J_rotation = -(across @ rotation.matrix()) * (rotated * seen).sum(axis=1)[:, None]
    basis = np.linalg.norm(baseline) * gtsam.Unit3(baseline).basis()
    J_direction = (values * (rotated @ baseline))[:, None] * (rotated @ basis)
    J_motion = np.hstack([J_rotation, J_direction]) / square[:, None]
    return InverseDepths(ids, values, sigmas, J_motion @ square_root(covariance))


def scale_ratio(unit: InverseDepths, known: InverseDepths) -> LogScale | None:
    """Scale at which newly triangulated depths agree with known ones; None with too few points in common."""
    mine, theirs = unit.match(known.ids)
    unit, known = unit[mine], known[theirs]
    usable = (unit.values > unit.sigmas) & (known.values > known.sigmas)
    if usable.sum() < MIN_COMMON:
        return None
    unit, known = unit[usable], known[usable]
    log_ratio = np.log(unit.values / known.values)
    sigma = np.hypot(unit.sigmas / unit.values, known.sigmas / known.values)
    mean = median(log_ratio)
    for _ in range(RATIO_ITERATIONS):
        weight = 1 / (sigma**2 * (1 + ((log_ratio - mean) / sigma / 2) ** 2))
        information, before = float(weight.sum()), mean
        mean = float((weight * log_ratio).sum()) / information
        if (mean - before) ** 2 * information < CONVERGED**2:
            break
    return LogScale(mean, float((weight**2 * (log_ratio - mean) ** 2).sum() / weight.sum() ** 2))


def typical_depth(
    known: InverseDepths, rays: NDArray[np.float64], down: NDArray[np.float64] | None, height: float
) -> float:
    """Metres to what is seen, by known depths or else by where the ground would be.

    Args:
        known: Depths of what is seen, if any are known.
        rays: (N, 3) towards what is seen, z = 1.
        down: (3,) unit vector to the ground; None where there is none.
        height: Of the camera above the ground, metres; NaN where unknown.
    """
    if len(known):
        return float(1 / median(known.values))
    if down is None or not height > 0 or not len(rays):
        return UNKNOWN_DEPTH
    return height * median(1 / np.maximum(rays @ down, 1 / GROUND_REACH))
