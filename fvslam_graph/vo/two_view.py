"""Relative pose of two views from matched points: rotation and direction of travel, with their covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
import poselib
from numpy.typing import NDArray

from fvslam_graph.camera import Camera
from fvslam_graph.config import VoSettings
from fvslam_graph.features.tracks import Tracks
from fvslam_graph.vo.depth import InverseDepths, triangulate

KERNEL = 2.0  # deviations beyond which a match counts for less (Cauchy)
START_NOISE = 0.2  # pixels, of a track along each axis, until residuals tell it,
LEAST_NOISE = 0.05  # and what they can tell at least
WIDTHS = (8, 3, 1, 1, 1)  # limits within which tracks agree, by iteration: from a rough start, few do
FOUND = 2  # the first of these for what was found by all tracks
CONVERGED = 1e-5  # rad, of a step
SAME = 1e-3  # rad between rotations, and ten times that between directions, of one and the same solution
CLEARLY = 4.0  # deviations beyond which a match does not count
LONGEST = 0.1  # rad, step of the refinement
CELLS = (8, 6)  # of the image, within which tracks are taken to err alike: blur, rolling shutter, calibration
ENOUGH_CORNERS = 20  # for edges not to tell how corners err
SCALE_ITERATIONS = 3
LEAST_CURVATURE = 0.1  # of a loss, as a share of what least squares would have with its weights
BEHIND = 5.0  # deviations that a depth behind the camera counts for

Rays = NDArray[np.float64]


@dataclass(frozen=True)
class TwoView:
    """What two views truly measure: five degrees of freedom.

    Attributes:
        rotation: prev_R_cur.
        direction: (3,) unit vector in the previous camera, from there to the current one.
        covariance: (5, 5) in the tangent of gtsam.EssentialMatrix(rotation, Unit3(direction)): rotation, then
            direction in the plane of gtsam.Unit3.basis; radians.
        inliers: (N,) bool, which of the tracks agree.
        noise: Pixels, standard deviation of a corner's displacement along each axis, by these.
    """

    rotation: gtsam.Rot3
    direction: NDArray[np.float64]
    covariance: NDArray[np.float64]
    inliers: NDArray[np.bool_]
    noise: float


def rays(camera: Camera, pixels: NDArray[np.float64]) -> Rays:
    """Viewing rays (N, 3) of pixels (N, 2), with z = 1."""
    normalized = camera.normalize(pixels)
    return np.column_stack([normalized, np.ones(len(normalized))])


def estimate_two_view(
    tracks: Tracks,
    camera: Camera,
    settings: VoSettings,
    seed: int,
    expected: Sequence[gtsam.Pose3] = (),
    known: InverseDepths | None = None,
) -> TwoView | None:
    """The relative pose that explains best how points move, and what is known of their depths; None without one.

    Points on a plane have two solutions that explain two views alike, and noise often prefers the wrong one. So what
    five-point RANSAC finds (PoseLib) is set against the motions that are expected, all refined, and each has to
    account for the depths that it triangulates as well.

    Args:
        tracks: N matches.
        camera: Undistorted.
        settings: Thresholds.
        seed: Of the RANSAC.
        expected: Motions prev_T_cur.
        known: Depths of some of the tracks in the previous camera. They choose among the solutions and are no part of
            the chosen one, so that its error has nothing to do with theirs.

    Source: Nister 2004 (five points); Larsson et al., PoseLib (LO-RANSAC); covariance of an M-estimator after Huber,
    Robust Statistics, section 6.3, with clusters after Liang and Zeger 1986.
    """
    if len(tracks) < settings.min_inliers:
        return None
    model = poselib_camera(camera)
    ransac = {
        "max_epipolar_error": settings.ransac_threshold,
        "min_iterations": settings.ransac_iterations,
        "max_iterations": 20 * settings.ransac_iterations,
        "seed": seed,
    }
    bundle = {"loss_type": "CAUCHY", "loss_scale": KERNEL * START_NOISE}
    pose, _ = poselib.estimate_relative_pose(tracks.reference, tracks.current, model, model, ransac, bundle)
    found = gtsam.Pose3(gtsam.Rot3(pose.R), pose.t).inverse()
    matches = _Matches(tracks, rays(camera, tracks.reference), rays(camera, tracks.current), camera.fx, known)
    limit = 2**0.5 * settings.ransac_threshold  # of errors in both images, the distance in one shows the sum
    fits = [_refine(start, matches, limit, WIDTHS) for start in expected if np.linalg.norm(start.translation()) > 0]
    if np.linalg.norm(found.translation()) > 0 and not any(fit.is_at(found) for fit in fits):
        fits.append(_refine(found, matches, limit, WIDTHS[FOUND:]))
    if not fits:
        return None
    noise = min(fit.noise for fit in fits)
    best = min(fits, key=lambda fit: fit.cost(matches, noise)) if len(fits) > 1 else fits[0]
    inliers = (np.abs(best.distance) < limit) & matches.ahead(best.rotation, best.direction, limit)
    if inliers.sum() < max(settings.min_inliers, settings.min_inlier_share * len(tracks)):
        return None
    told = inliers & (np.abs(best.distance) < CLEARLY * best.noise)
    cells = neighbourhoods(tracks.reference[told], camera)
    covariance = m_estimator_covariance(best.distance[told], best.jacobian[told], KERNEL * best.noise, cells)
    if covariance is None:
        return None
    return TwoView(best.rotation, best.direction, covariance, inliers, best.noise)


@dataclass(frozen=True)
class _Matches:
    """N tracks, their rays (N, 3) in both views, and known depths of some in the previous one."""

    tracks: Tracks
    previous: Rays
    current: Rays
    focal: float
    known: InverseDepths | None

    def distance(
        self, rotation: gtsam.Rot3, direction: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Of the current points from their epipolar lines."""
        return epipolar_distance(self.previous, self.current, rotation, direction, self.focal, self.tracks.covariances)

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
        return max(float(np.median(errors)) / 0.6745, LEAST_NOISE) if len(errors) else limit

    def ahead(self, rotation: gtsam.Rot3, direction: NDArray[np.float64], limit: float) -> NDArray[np.bool_]:
        """(N,) which points are not seen behind the camera by more than a limit in the current image, pixels.

        A wrong match on the other side of the epipole lies on its line by chance, and has a long lever there.
        """
        endless = self.previous @ rotation.matrix()
        endless = endless[:, :2] / np.maximum(endless[:, 2:], 1e-3)  # where a point would be at any distance
        step = rotation.unrotate(direction)
        nearer = endless * step[2] - step[:2]  # whereto it goes if it is nearer
        moved = ((self.current[:, :2] - endless) * nearer).sum(axis=1) / np.maximum(
            np.linalg.norm(nearer, axis=1), 1e-9
        )
        return np.asarray(self.focal * moved > -limit)


@dataclass(frozen=True)
class _Fit:
    """A relative pose and how well it explains the tracks: epipolar distances, their Jacobian, the noise they show."""

    rotation: gtsam.Rot3
    direction: NDArray[np.float64]
    distance: NDArray[np.float64]
    jacobian: NDArray[np.float64]
    noise: float

    def is_at(self, pose: gtsam.Pose3) -> bool:
        """Whether a pose leads to this one."""
        turned = np.linalg.norm(gtsam.Rot3.Logmap(self.rotation.between(pose.rotation())))
        off = np.linalg.norm(self.direction - pose.translation() / np.linalg.norm(pose.translation()))
        return bool(turned < SAME and off < 10 * SAME)

    def cost(self, matches: _Matches, noise: float) -> float:
        """Cauchy cost of the epipolar distances, and of how the depths depart from those known, up to their scale."""
        cost = float(np.log1p((self.distance / (KERNEL * noise)) ** 2).sum())
        if matches.known is None:
            return cost
        tracks, known = matches.tracks, matches.known
        depths = triangulate(
            tracks.ids,
            matches.previous,
            matches.current,
            self.rotation,
            self.direction,
            matches.focal,
            noise,
            covariances=tracks.covariances,
        )
        mine, theirs = depths.common(known.ids)
        values, variance = depths.values[mine], depths.sigmas[mine] ** 2
        reference, doubt = known.values[theirs], known.total_sigmas[theirs] ** 2
        ahead = values > 0
        if not ahead.any():
            return cost + len(mine) * float(np.log1p((BEHIND / KERNEL) ** 2))
        scale = float(np.exp(np.median(np.log(values[ahead] / reference[ahead]))))
        for _ in range(SCALE_ITERATIONS):
            total = variance + scale**2 * doubt
            square = (values - scale * reference) ** 2 / total
            weight = 1 / total / (1 + square / KERNEL**2)
            scale = float((weight * values * reference).sum() / (weight * reference**2).sum())
        return cost + float(np.log1p(square / KERNEL**2).sum())


def _refine(start: gtsam.Pose3, matches: _Matches, limit: float, widths: Sequence[int]) -> _Fit:
    """The relative pose near another by the tracks that agree with it (iteratively reweighted least squares)."""
    rotation = start.rotation()
    direction = start.translation() / np.linalg.norm(start.translation())
    ahead = None
    for width in widths:
        distance, jacobian = matches.distance(rotation, direction)
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
        length = float(np.linalg.norm(step))
        step *= min(1.0, LONGEST / max(length, 1e-12))
        rotation = rotation.retract(step[:3])
        direction = gtsam.Unit3(direction).retract(step[3:]).point3()
        if width == 1 and length < CONVERGED:
            break
    distance, jacobian = matches.distance(rotation, direction)
    return _Fit(rotation, direction, distance, jacobian, matches.noise(distance, limit))


def poselib_camera(camera: Camera) -> dict[str, object]:
    """The undistorted camera as PoseLib takes it."""
    parameters = [camera.fx, camera.fy, camera.cx, camera.cy]
    return {"model": "PINHOLE", "width": camera.width, "height": camera.height, "params": parameters}


def epipolar_distance(
    previous: Rays,
    current: Rays,
    rotation: gtsam.Rot3,
    direction: NDArray[np.float64],
    focal: float,
    covariances: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far current points are from the epipolar lines of the previous ones, (N,), and its Jacobian (N, 5).

    A tracker errs about the displacement from the previous image, so the distance is measured in the current one.

    Args:
        previous, current: (N, 3) rays, z = 1.
        rotation: prev_R_cur.
        direction: (3,) unit vector in the previous camera, from there to the current one.
        focal: Pixels.
        covariances: (N, 2, 2) as of Tracks; with them, a distance is as long as if it were a corner's.

    Returns:
        Pixels, and in the tangent of TwoView.
    """
    R = rotation.matrix()
    line = cross(previous, direction) @ R
    length = np.maximum(np.hypot(line[:, 0], line[:, 1]), 1e-9)  # a point on the epipole has no line
    normal = line[:, :2] / length[:, None]
    distance = (line * current).sum(axis=1) / length
    foot = current.copy()  # of the perpendicular: seen from there, it does not matter how the normal turns
    foot[:, :2] -= distance[:, None] * normal
    weight: NDArray[np.float64] = focal / length
    if covariances is not None:
        weight = weight / np.sqrt((normal * (covariances @ normal[:, :, None])[:, :, 0]).sum(axis=1))
    by_direction = cross(foot @ R.T, previous) @ gtsam.Unit3(direction).basis()
    return distance * length * weight, weight[:, None] * np.hstack([cross(foot, line), by_direction])


def cross(a: Rays, b: NDArray[np.float64]) -> Rays:
    """Cross products of vectors (N, 3) with others, or with one: np.cross takes several times as long."""
    x, y, z = b.T
    return np.stack([a[:, 1] * z - a[:, 2] * y, a[:, 2] * x - a[:, 0] * z, a[:, 0] * y - a[:, 1] * x], axis=1)


def neighbourhoods(pixels: NDArray[np.float64], camera: Camera) -> NDArray[np.intp]:
    """Numbers (N,) of the cells of the image that points (N, 2) lie in."""
    cells = (pixels * np.divide(CELLS, (camera.width, camera.height))).astype(np.intp).clip(0, np.subtract(CELLS, 1))
    return np.asarray(cells[:, 1] * CELLS[0] + cells[:, 0])


def clustered(scores: NDArray[np.float64], clusters: NDArray[np.intp]) -> NDArray[np.float64]:
    """Scores (N, P) of residuals summed over each of C clusters, (C, P)."""
    member = np.zeros((int(clusters.max(initial=0)) + 1, len(scores)))
    member[clusters, np.arange(len(scores))] = 1.0
    return member[member.any(axis=1)] @ scores


def by_few(count: int, parameters: int) -> float:
    """How much larger a covariance of so many parameters must be that is told by so few groups of residuals.

    These are smaller than errors, since they were minimised; and a sum of so few squares is now and then too small by
    far (Hotelling 1931).
    """
    return count / (count - parameters) * (count - 1) / max(count - parameters - 2, 1)


def cauchy_curvature(residual: NDArray[np.float64]) -> float:
    """Mean second derivative of a Cauchy loss of scale 1 by the mean of the weights that it gives residuals (N,)."""
    weight = 1 / (1 + residual**2)
    return float((weight * (1 - residual**2) * weight).sum() / max(weight.sum(), 1e-12))


def inverse_curvature(information: NDArray[np.float64], bent: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Inverse (P, P) of the second derivative of a sum of Cauchy losses; None where it determines nothing.

    Args:
        information: (P, P) as if the weights that the losses give to residuals were given.
        bent: (N, P) gradients of the losses, by whose squares they bend away from that. Where few residuals tell
            something and these are large, more than all could be gone: a tenth is left.
    """
    values = np.linalg.eigvalsh(information)
    if not values[0] > 1e-12 * values[-1]:
        return None
    root = np.linalg.inv(np.linalg.cholesky(information))
    share, axes = np.linalg.eigh(root @ (information - 2 * bent.T @ bent) @ root.T)
    inverse: NDArray[np.float64] = root.T @ (axes / np.maximum(share, LEAST_CURVATURE)) @ axes.T @ root
    return inverse


def m_estimator_covariance(
    residual: NDArray[np.float64],
    jacobian: NDArray[np.float64],
    loss_scale: float,
    clusters: NDArray[np.intp],
) -> NDArray[np.float64] | None:
    """Covariance of a Cauchy M-estimate from the residuals themselves, so that no noise level is assumed.

    Args:
        residual: (N,) at the estimate.
        jacobian: (N, P) of the residuals.
        loss_scale: Of the Cauchy loss, in the residuals' unit.
        clusters: (N,) numbers of groups of residuals, which are independent of other groups and need not be within.

    Returns:
        (P, P); None where the residuals do not determine the parameters.
    """
    parameters = jacobian.shape[1]
    weight = 1 / (1 + (residual / loss_scale) ** 2)
    each = (residual * weight)[:, None] * jacobian
    inverse = inverse_curvature(jacobian.T @ (weight[:, None] * jacobian), each / loss_scale)
    scores = clustered(each, clusters)
    count = len(scores)
    if count <= parameters or inverse is None:
        return None
    covariance: NDArray[np.float64] = inverse @ (scores.T @ scores) @ inverse * by_few(count, parameters)
    return (covariance + covariance.T) / 2
