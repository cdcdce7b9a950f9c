"""Inverse depths of tracks: triangulated from two views, and carried from one keyframe to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import by_calibration
from fvslam_graph.core.gaussian_pose import LogScale, square_root
from fvslam_graph.core.inverse_depths import InverseDepths
from fvslam_graph.core.quick import median
from fvslam_graph.core.tracks import variances_along
from fvslam_graph.vo.epipolar import MatchedRays
from fvslam_graph.vo.m_estimator import m_estimator_covariance

PIXEL_NOISE = 0.3  # pixels, of a displacement along each axis, where no motion has told it
GROUND_REACH = 20.0  # heights; a guess at where something stands in front of the ground, for a camera above it,
MIN_COMMON = 10  # tracks of known depth that tell a scale
RATIO_ITERATIONS, CONVERGED = 10, 0.1  # at most, and deviations of a step after which nothing changes
RATIO_KERNEL = 2.0  # deviations from which on tracks count for less
UNKNOWN_DEPTH = 10.0  # and at how far away things are for one whose height is unknown, metres


def triangulate(
    ids: NDArray[np.int64],
    matched: MatchedRays,
    rotation: gtsam.Rot3,
    baseline: NDArray[np.float64],
    noise: float = PIXEL_NOISE,
    covariance: NDArray[np.float64] | None = None,
    J_calibration: NDArray[np.float64] | None = None,
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
        J_calibration: (5, 2) how these change with the calibration; without a covariance, it is not asked for.
    """
    previous, focal, covariances = matched.previous, matched.focal, matched.covariances
    rotated = matched.current @ rotation.matrix().T
    across = rotated @ gtsam.SO3.Hat(baseline)  # rotated x baseline
    square, along = np.maximum(np.vecdot(across, across), 1e-18), np.vecdot(rotated, previous)
    rotated_square, rotated_along = np.vecdot(rotated, rotated), rotated @ baseline
    values = (rotated_square * (previous @ baseline) - along * rotated_along) / square
    # How fast the image of the point moves along its epipolar line when rho changes.
    seen = previous - values[:, None] * baseline
    turned, step = seen @ rotation.matrix(), rotation.unrotate(baseline)
    line = (step[2] * turned[:, :2] - step[:2] * turned[:, 2:]) / turned[:, 2:] ** 2
    speed = np.maximum(np.hypot(*line.T), 1e-9)
    sigmas = noise / (focal * speed)
    if covariances is not None:
        sigmas *= np.sqrt(variances_along(line, covariances)) / speed
    if covariance is None:
        return InverseDepths.independent(ids, values, sigmas)
    # For y = R (1 + [w]x) y0 and b + |b| B d the cross product above changes by (R w x y) x seen - rho y x (|b| B d).
    facing = np.vecdot(rotated, seen)
    J_rotation = -(across @ rotation.matrix()) * facing[:, None]
    basis = np.linalg.norm(baseline) * gtsam.Unit3(baseline).basis()
    J_direction = (values * rotated_along)[:, None] * (rotated @ basis)
    J_motion = np.hstack([J_rotation, J_direction]) / square[:, None]
    # Likewise, with the rays of both views: by across x rotated and seen x across.
    J_previous = rotated_square[:, None] * baseline - rotated_along[:, None] * rotated
    J_current = (seen @ baseline)[:, None] * rotated - facing[:, None] * baseline
    J_depths = by_calibration(previous, J_previous[:, :2])
    J_depths += by_calibration(matched.current, J_current @ rotation.matrix()[:, :2])
    J_depths /= square[:, None]
    if J_calibration is not None:
        J_depths += J_motion @ J_calibration
    return InverseDepths(ids, values, sigmas, J_motion @ square_root(covariance), J_depths)


@dataclass(frozen=True)
class ScaleRatio:
    """Scale at which newly triangulated depths agree with known ones.

    Attributes:
        scale: Its logarithm.
        J_calibration: (2,) how this changes with the calibration.
    """

    scale: LogScale
    J_calibration: NDArray[np.float64]


def scale_ratio(unit: InverseDepths, known: InverseDepths) -> ScaleRatio | None:
    """Scale at which newly triangulated depths agree with known ones; None with too few points in common.

    What the depths of either err together does not average out over points: it is estimated along with the scale,
    expected to be as large as the motions were uncertain. Iteratively reweighted least squares (Cauchy), by a noise
    that is at least that of the residuals.

    The variance is that of what each depth errs for itself. What is left of errors in common is taken back at the next
    keyframe, where the new depths are the known ones: it is no drift.
    """
    mine, theirs = unit.match(known.ids)
    unit, known = unit[mine], known[theirs]
    usable = (unit.values > unit.sigmas) & (known.values > known.sigmas)
    if usable.sum() < MIN_COMMON:
        return None
    unit, known = unit[usable], known[usable]
    log_ratio = np.log(unit.values / known.values)
    known_sigma = known.sigmas / known.values
    sigma = np.hypot(unit.sigmas / unit.values, known_sigma)
    prior = np.diag(np.concatenate([[0.0], np.ones(unit.common.shape[1] + known.common.shape[1])]))
    found = np.zeros(len(prior))  # the scale, and the errors in common
    found[0] = median(log_ratio)
    for _ in range(RATIO_ITERATIONS):
        # Of a depth that is too small by chance, common errors would be too large a share: the scale would grow.
        likeliest = known.values * np.exp((known_sigma / sigma) ** 2 * (log_ratio - found[0]))
        shares = np.hstack([unit.common / math.exp(found[0]), -known.common]) / likeliest[:, None]
        design = np.column_stack([np.ones(len(sigma)), shares])
        residual = log_ratio - design @ found
        noise = sigma * max(1.0, median(np.abs(residual) / sigma) / 0.6745)
        weight = 1 / (noise**2 * (1 + (residual / noise / RATIO_KERNEL) ** 2))
        weighted = weight[:, None] * design
        information = weighted.T @ design + prior
        before, found = found[0], np.linalg.solve(information, weighted.T @ log_ratio)
        if (found[0] - before) ** 2 * weight.sum() < CONVERGED**2:
            break
    residual = ((log_ratio - design @ found) / noise)[:, None]
    covariance = m_estimator_covariance(residual, 1 / noise[:, None, None], RATIO_KERNEL)
    if covariance is None:
        return None
    J_log_ratio = unit.J_calibration / unit.values[:, None] - known.J_calibration / known.values[:, None]
    J_calibration = np.linalg.solve(information, weighted.T @ J_log_ratio)[0]
    return ScaleRatio(LogScale(float(found[0]), float(covariance[0, 0])), J_calibration)


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
    if usual := known.usual:
        return 1 / usual
    if down is None or not height > 0 or not len(rays):
        return UNKNOWN_DEPTH
    return height * median(1 / ground_depths(rays, down))


def ground_depths(rays: NDArray[np.float64], down: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverse depths (N,) of the ground at distance 1 along rays (N, 3), z = 1; far away where it is not seen."""
    return np.maximum(rays @ down, 1 / GROUND_REACH)
