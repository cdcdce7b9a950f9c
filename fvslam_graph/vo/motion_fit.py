"""A relative pose refined by all tracks, how well it explains them, and what else would."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.inverse_depths import InverseDepths
from fvslam_graph.core.quick import median
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.core.vo_estimate import CalibrationEvidence
from fvslam_graph.vo.deformation import undeformed
from fvslam_graph.vo.depth import PIXEL_NOISE, ground_depths, triangulate
from fvslam_graph.vo.epipolar import MatchedRays, calibration_jacobian, epipolar_distance
from fvslam_graph.vo.m_estimator import clustered

KERNEL = 2.0  # deviations beyond which a match counts for less (Cauchy)
MIN_NOISE = 0.05  # pixels, of a track along each axis, that residuals can tell at least
WIDTHS = (8, 3, 1, 1, 1, 1, 1, 1)  # limits within which tracks agree, by iteration: from a rough start, few do
FOUND = 2  # the first of these for what was found by all tracks
CONVERGED_STEP = 0.1  # deviations of the motion that a step goes
# Of a step with weights: where errors are normal, the loss bends by three quarters of what its weights say, so that
# such steps alone would leave a quarter of the way each time, and they would tell a third too much.
RELAXED = 4 / 3
CLEARLY = 4.0  # deviations beyond which a match does not count
MOST = 0.8  # of the tracks; where these agree with the motion that is expected,
# rad; and fix the direction of travel as well as this, RANSAC finds nothing else, and known depths need not help.
CERTAIN_DIRECTION = 0.002
SAME = 1e-3  # rad between rotations, and ten times that between directions, of one and the same solution
MAX_STEP = 0.1  # rad, step of the refinement
ENOUGH_CORNERS = 20  # for edges not to tell how corners err
SCALE_ITERATIONS = 3
MAX_BEHIND = 5.0  # deviations that a depth behind the camera counts for
PLANE_ITERATIONS = 3
SPREAD = 0.5  # of inverse depths about what is usual, where none is known: all are ahead, few much nearer than others


@dataclass(frozen=True)
class MatchedTracks:
    """N tracks, their rays in both views, and in the previous one known depths of some, and where the ground is."""

    camera: Camera
    tracks: Tracks
    rays: MatchedRays
    known: InverseDepths | None
    down: NDArray[np.float64] | None

    @cached_property
    def usual(self) -> NDArray[np.float64]:
        """(N,) inverse depths of a scene of which nothing is known, up to its scale: the ground, or all alike."""
        return np.ones(len(self.tracks)) if self.down is None else ground_depths(self.rays.previous, self.down)

    @cached_property
    def _corners(self) -> NDArray[np.bool_]:
        """(N,) which tracks are none of edges, if these are enough."""
        corners = self.tracks.covariances.trace(axis1=1, axis2=2) < 3
        return corners if corners.sum() > ENOUGH_CORNERS else np.ones_like(corners)

    def noise(self, distance: NDArray[np.float64], limit: float) -> float:
        """Pixels by which corners err along each axis, from the distances (N,) of tracks that agree.

        Without edges: their large variances are no measure of what they err.
        """
        errors = np.abs(distance[self._corners])
        errors = errors[errors < limit]
        return max(median(errors) / 0.6745, MIN_NOISE) if len(errors) else limit

    def depths(self, rotation: gtsam.Rot3, direction: NDArray[np.float64], noise: float = PIXEL_NOISE) -> InverseDepths:
        """(N,) by a relative pose, in baselines."""
        return triangulate(self.tracks.ids, self.rays, rotation, direction, noise)

    def undeformed(self, rotation: gtsam.Rot3, direction: NDArray[np.float64]) -> MatchedTracks:
        """The same tracks without what this change of view makes them err."""
        depths = self.depths(rotation, direction)
        tracks = undeformed(self.tracks, self.rays, rotation, direction, depths)
        return replace(self, tracks=tracks, rays=MatchedRays.of(self.camera, tracks))

    def ahead(self, rotation: gtsam.Rot3, direction: NDArray[np.float64], limit: float) -> NDArray[np.bool_]:
        """(N,) which points are not seen behind the camera by more than a limit in the current image, pixels.

        A wrong match on the other side of the epipole lies on its line by chance, and has a long lever there.
        """
        endless = self.rays.previous @ rotation.matrix()
        endless = endless[:, :2] / np.maximum(endless[:, 2:], 1e-3)  # where a point would be at any distance
        step = rotation.unrotate(direction)
        nearer = endless * step[2] - step[:2]  # whereto it goes if it is nearer
        moved = np.vecdot(self.rays.current[:, :2] - endless, nearer) / np.maximum(np.hypot(*nearer.T), 1e-9)
        return np.asarray(self.rays.focal * moved > -limit)


@dataclass(frozen=True)
class Fit:
    """A relative pose and how well it explains the tracks: epipolar distances, their Jacobian, the noise they show."""

    rotation: gtsam.Rot3
    direction: NDArray[np.float64]
    matches: MatchedTracks
    distance: NDArray[np.float64]
    jacobian: NDArray[np.float64]
    noise: float

    def is_at(self, rotation: gtsam.Rot3, direction: NDArray[np.float64]) -> bool:
        """Whether a relative pose leads to this one."""
        turned = np.linalg.norm(gtsam.Rot3.Logmap(self.rotation.between(rotation)))
        off = np.linalg.norm(self.direction - direction)
        return bool(turned < SAME and off < 10 * SAME)

    def explained(self, limit: float) -> NDArray[np.bool_]:
        """(N,) which tracks agree within a limit, pixels."""
        return (np.abs(self.distance) < limit) & self.matches.ahead(self.rotation, self.direction, limit)

    def is_beyond_doubt(self, limit: float) -> bool:
        """Whether no other motion can explain the tracks: most agree, and they fix the direction of travel."""
        if self.explained(limit).mean() < MOST:
            return False
        weight = 1 / (1 + (self.distance / (KERNEL * self.noise)) ** 2)
        information = self.jacobian.T @ (weight[:, None] * self.jacobian)
        information[np.diag_indices(5)] += 1e-12
        variances = self.noise**2 * np.linalg.inv(information)[3:, 3:]
        return bool(np.trace(variances) < CERTAIN_DIRECTION**2)

    def calibration(self, told: NDArray[np.bool_]) -> tuple[NDArray[np.float64], CalibrationEvidence]:
        """How the pose changes with the calibration, (5, 2), and what tracks `told` (N,) say of it beside the pose."""
        distance, jacobian = self.distance[told], self.jacobian[told]
        columns = calibration_jacobian(self.matches.rays, self.rotation, self.direction)[told]
        weight = 1 / (1 + (distance / (KERNEL * self.noise)) ** 2)
        pull = jacobian.T @ (weight[:, None] * columns)
        J_calibration = -np.linalg.inv(jacobian.T @ (weight[:, None] * jacobian)) @ pull
        information = (columns.T @ (weight[:, None] * columns) + pull.T @ J_calibration) / RELAXED
        gradient = -columns.T @ (weight * distance)
        evidence = CalibrationEvidence(information / self.noise**2, gradient / self.noise**2)
        return np.asarray(J_calibration[:, :2], float), evidence

    def others_of_a_plane(self) -> Iterator[gtsam.Pose3]:
        """What else explains images of a plane, if that is what this says they show: normal and direction exchanged."""
        depths = self.matches.depths(self.rotation, self.direction, self.noise)
        rays, weight = self.matches.rays.previous, 1 / depths.sigmas**2
        for _ in range(PLANE_ITERATIONS):
            plane = np.linalg.lstsq((weight * rays.T) @ rays, rays.T @ (weight * depths.values))[0]
            off = depths.values - rays @ plane
            weight = 1 / (depths.sigmas**2 + median(np.abs(off)) ** 2 + off**2)
        homography = self.rotation.matrix().T @ (np.eye(3) - np.outer(self.direction, plane))
        _, rotations, translations, normals = cv2.decomposeHomographyMat(homography, np.eye(3))
        for R, t, normal in zip(rotations, translations, normals, strict=True):
            other = gtsam.Pose3(gtsam.Rot3(R), t.ravel()).inverse()
            is_ahead = median(rays @ normal.ravel()) > 0
            if is_ahead and not self.is_at(other.rotation(), gtsam.Unit3(other.translation()).point3()):
                yield other

    def spread(self, fits: Sequence[Fit], told_apart: NDArray[np.float64]) -> NDArray[np.float64]:
        """(5, 5) second moments about this of all that was found, by the deviations (F,) that tell this from each.

        Motions that explain images alike may lie along a curve, which no covariance of one of them tells.
        """
        odds = np.array([math.erfc(z / 2**0.5) / math.erfc(-z / 2**0.5) for z in told_apart])  # of a normal variable
        steps = np.array([self._essential.localCoordinates(fit._essential) for fit in fits])
        weighed = np.sqrt(odds / odds.sum())[:, None] * steps
        return np.asarray(weighed.T @ weighed)

    @property
    def _essential(self) -> gtsam.EssentialMatrix:
        return gtsam.EssentialMatrix(self.rotation, gtsam.Unit3(self.direction))

    def distance_costs(self, noise: float) -> NDArray[np.float64]:
        """(N,) Cauchy costs of the epipolar distances."""
        return np.asarray(np.log1p((self.distance / (KERNEL * noise)) ** 2))

    def depth_costs(self, noise: float) -> NDArray[np.float64]:
        """(N,) Cauchy costs of how depths depart from those known, up to their scale; 0 where none is.

        Where none is known at all, they are taken to be about as usual.
        """
        known, depths = self.matches.known, self.matches.depths(self.rotation, self.direction, noise)
        if known is None:
            usual = self.matches.usual
            known = InverseDepths.independent(depths.ids, usual, SPREAD * usual)
        costs = np.zeros(len(depths))
        mine, theirs = depths.match(known.ids)
        values, variance = depths.values[mine], depths.sigmas[mine] ** 2
        expected, doubt = known.values[theirs], known.total_sigmas[theirs] ** 2
        ahead = values > 0
        if not ahead.any():
            costs[mine] = np.log1p((MAX_BEHIND / KERNEL) ** 2)
            return costs
        scale = math.exp(median(np.log(values[ahead] / expected[ahead])))
        for _ in range(SCALE_ITERATIONS):
            total = variance + scale**2 * doubt
            square = (values - scale * expected) ** 2 / total
            weight = 1 / total / (1 + square / KERNEL**2)
            scale = float((weight * values * expected).sum() / (weight * expected**2).sum())
        costs[mine] = np.log1p(square / KERNEL**2)
        return costs


def told_apart(others: NDArray[np.float64], best: NDArray[np.float64], cells: NDArray[np.intp]) -> NDArray[np.float64]:
    """Deviations of chance, (F,), by which tracks are explained better, costs (N,), than by others, (F, N).

    Source: Vuong 1989; by neighbourhoods of the image, whose tracks err alike.
    """
    gains = clustered((others - best).T, cells)
    return np.asarray(gains.sum(axis=0) / np.maximum(np.linalg.norm(gains, axis=0), 1e-9))


def refine(
    start: gtsam.Pose3, matches: MatchedTracks, limit: float, widths: Sequence[int], known: Sequence[Fit]
) -> Fit | None:
    """The relative pose near another by the tracks that agree with it (iteratively reweighted least squares).

    None where it becomes one that is known.
    """
    rotation = start.rotation()
    direction = start.translation() / np.linalg.norm(start.translation())
    ahead = None
    for width in widths:
        if any(fit.is_at(rotation, direction) for fit in known):
            return None
        if width == 1 and ahead is None:
            matches = matches.undeformed(rotation, direction)
        distance, jacobian = epipolar_distance(matches.rays, rotation, direction)
        noise = width * matches.noise(distance, limit)
        agree = np.abs(distance) < min(width * limit, CLEARLY * noise)
        if width == 1:
            ahead = matches.ahead(rotation, direction, limit) if ahead is None else ahead
            agree &= ahead
        weight = agree / (1 + (distance / (KERNEL * noise)) ** 2)
        weighted = weight[:, None] * jacobian
        information = weighted.T @ jacobian
        information[np.diag_indices(5)] += 1e-9 * np.trace(information) + 1e-12  # fewer than five may agree
        step = -np.linalg.solve(information, weighted.T @ distance)
        deviations = math.sqrt(step @ information @ step) * width / noise
        step *= min(RELAXED if width == 1 else 1.0, MAX_STEP / max(math.sqrt(step @ step), 1e-12))
        rotation = rotation.retract(step[:3])
        direction = gtsam.Unit3(direction).retract(step[3:]).point3()
        if width == 1 and deviations < CONVERGED_STEP:
            break
    distance, jacobian = epipolar_distance(matches.rays, rotation, direction)
    return Fit(rotation, direction, matches, distance, jacobian, matches.noise(distance, limit))
