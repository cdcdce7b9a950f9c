"""Relative pose of two views from matched points: rotation and direction of travel, with their covariance."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import VoSettings
from fvslam_graph.core.inverse_depths import InverseDepths
from fvslam_graph.core.sequence import Frame
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.core.vo_estimate import CalibrationEvidence
from fvslam_graph.features.ransac import RansacOptions, relative_poses
from fvslam_graph.vo.epipolar import MatchedRays, Rays
from fvslam_graph.vo.m_estimator import m_estimator_covariance, neighbourhoods
from fvslam_graph.vo.motion_fit import (
    CERTAIN_DIRECTION,
    CLEARLY,
    FOUND,
    KERNEL,
    WIDTHS,
    Fit,
    MatchedTracks,
    refine,
    told_apart,
)
from fvslam_graph.vo.rotation import fit_rotation, motion_given_rotation

START_NOISE = 0.2  # pixels, of a track along each axis, until residuals tell it
ROUGH = 5  # iterations of PoseLib's refinement, which is done again with all tracks
# Of RANSAC's threshold, where no depths are known that would choose: within a wide one, a motion that is nearly right
# for all tracks has more inliers than one that is right for most.
NARROW = 0.25
RANSAC_TRACKS = 120  # that RANSAC looks at, at least, where there are more
REFUTED = 3.0  # deviations of chance, by which one motion explains the images better than another


@dataclass(frozen=True)
class RelativePose:
    """The relative pose that two views truly measure: five degrees of freedom.

    Attributes:
        rotation: prev_R_cur.
        direction: (3,) unit vector in the previous camera, from there to the current one.
        covariance: (5, 5) in the tangent of gtsam.EssentialMatrix(rotation, Unit3(direction)): rotation, then
            direction in the plane of gtsam.Unit3.basis; radians.
        inliers: (N,) bool, which of the tracks agree.
        current: (N, 2) pixels in the current image, without what the change of view makes the tracker err.
        noise: Pixels, standard deviation of a corner's displacement along each axis, by these.
        J_calibration: (5, 2) how the pose changes with the logarithm of the focal length and with k1.
        evidence: What the views say of these two; None where they were not asked.
        refutes_depths: The motion that agrees with the depths that were known does not explain the images: the depths
            are wrong.
        spread: (5, 5) what is to be added to the covariance for other motions that explain the images about as well.
    """

    rotation: gtsam.Rot3
    direction: NDArray[np.float64]
    covariance: NDArray[np.float64]
    inliers: NDArray[np.bool_]
    current: NDArray[np.float64]
    noise: float
    J_calibration: NDArray[np.float64]
    evidence: CalibrationEvidence | None = None
    refutes_depths: bool = False
    spread: NDArray[np.float64] = field(default_factory=lambda: np.zeros((5, 5)))

    @property
    def unit_pose(self) -> gtsam.Pose3:
        """prev_T_cur in baselines."""
        return gtsam.Pose3(self.rotation, self.direction)

    @property
    def is_certain(self) -> bool:
        """Whether the direction of travel is known so well that no depths need to help."""
        return bool(np.trace(self.covariance[3:, 3:]) < CERTAIN_DIRECTION**2)


@dataclass(frozen=True)
class TwoViews:
    """Two frames with what was measured between them.

    Attributes:
        previous, current: The frames.
        relative_pose: Up to the length of the baseline.
        rays: (N, 3) of tracks in the previous frame.
        depths: (N,) of these tracks, in baselines.
    """

    previous: Frame
    current: Frame
    relative_pose: RelativePose
    rays: Rays
    depths: InverseDepths


def estimate_relative_pose(
    tracks: Tracks,
    camera: Camera,
    settings: VoSettings,
    seed: int,
    expected: Iterable[gtsam.Pose3] = (),
    known: InverseDepths | None = None,
    down: NDArray[np.float64] | None = None,
) -> RelativePose | None:
    """The relative pose that explains best how points move, and what is known of their depths; None without one.

    Points on a plane have two solutions that explain two views alike, and noise often prefers the wrong one. So what
    five-point RANSAC finds is set against the motions that are expected, all refined, and each has to
    account for the depths that it triangulates as well.

    Args:
        tracks: N matches.
        camera: Undistorted.
        settings: Thresholds.
        seed: Of the RANSAC.
        expected: Motions prev_T_cur, of which each is asked for only if those before it leave a doubt, as is RANSAC.
        known: Depths of some of the tracks in the previous camera. They choose among the solutions and are no part of
            the chosen one, so that its error has nothing to do with theirs.
        down: (3,) unit vector to the ground in the previous camera: where no depths are known, the scene is taken to be
            about there; None where there is none.
    """
    if len(tracks) < settings.min_inliers:
        return None
    matches = MatchedTracks(camera, tracks, MatchedRays.of(camera, tracks), known, down)
    limit = 2**0.5 * settings.ransac_threshold  # of errors in both images, the distance in one shows the sum
    fits: list[Fit] = []
    for start, widths in _with_others_of_a_plane(_starts(matches, settings, seed, expected), fits):
        if np.linalg.norm(start.translation()) > 0 and (fit := refine(start, matches, limit, widths, fits)):
            fits.append(fit)
            if fit.is_beyond_doubt(limit):
                break
    if not fits:
        return None
    best, spread, refutes_depths = _chosen(fits, matches, limit)
    inliers = best.explained(limit)
    if inliers.sum() < max(settings.min_inliers, settings.min_inlier_share * len(tracks)):
        return None
    told = inliers & (np.abs(best.distance) < CLEARLY * best.noise)
    cells = neighbourhoods(tracks.keyframe[told], camera)
    distance, jacobian = best.distance[told, None], best.jacobian[told, None]
    covariance = m_estimator_covariance(distance, jacobian, KERNEL * best.noise, cells)
    if covariance is None:
        return None
    J_calibration, evidence = best.calibration(told)
    current = best.matches.tracks.current
    return RelativePose(
        best.rotation,
        best.direction,
        covariance,
        inliers,
        current,
        best.noise,
        J_calibration,
        evidence,
        refutes_depths,
        spread,
    )


def _chosen(fits: Sequence[Fit], matches: MatchedTracks, limit: float) -> tuple[Fit, NDArray[np.float64], bool]:
    """The motion that explains the images and known depths best; its `spread`, and whether it `refutes_depths`."""
    if len(fits) == 1:
        return fits[0], np.zeros((5, 5)), False
    noise = min(fit.noise for fit in fits)
    by_images = np.array([fit.distance_costs(noise) for fit in fits])
    costs = by_images + [fit.depth_costs(noise) for fit in fits]
    chosen, last, refutes_depths = int(costs.sum(axis=1).argmin()), len(fits) - 1, False
    cells = neighbourhoods(matches.tracks.keyframe, matches.camera)
    if matches.known is not None and fits[last].is_beyond_doubt(limit):
        refutes_depths = bool(told_apart(by_images[[chosen]], by_images[last], cells)[0] > REFUTED)
    if refutes_depths:
        chosen, costs = last, by_images
    return fits[chosen], fits[chosen].spread(fits, told_apart(costs, costs[chosen], cells)), refutes_depths


def _with_others_of_a_plane(
    starts: Iterable[tuple[gtsam.Pose3, Sequence[int]]], fits: Sequence[Fit]
) -> Iterator[tuple[gtsam.Pose3, Sequence[int]]]:
    """Each start, and after the motion that it led to, by then the last of `fits`, the others of its plane."""
    for start, widths in starts:
        before = len(fits)
        yield start, widths
        if len(fits) > before:
            for other in fits[before].others_of_a_plane():
                yield other, WIDTHS[FOUND:]


def _starts(
    matches: MatchedTracks, settings: VoSettings, seed: int, expected: Iterable[gtsam.Pose3]
) -> Iterator[tuple[gtsam.Pose3, Sequence[int]]]:
    """Motions that may be near the right one, the cheapest first, each with the widths that it is refined by."""
    for start in expected:
        yield start, WIDTHS
    some = matches.tracks[a_sample(len(matches.tracks))]
    for share in (1.0, NARROW) if matches.known is None else (1.0,):
        options = ransac_options(share * settings.ransac_threshold, settings, seed)
        for start in relative_poses(some.keyframe, some.current, matches.camera, options):
            yield start, WIDTHS[FOUND:]
    if matches.known is None:
        rays = matches.rays.previous, matches.rays.current
        yield motion_given_rotation(fit_rotation(*rays, matches.rays.focal)[0], *rays), WIDTHS


def a_sample(count: int) -> NDArray[np.intp]:
    """Which of so many tracks RANSAC looks at: what it finds is refined by all."""
    return np.arange(0, count, max(1, count // RANSAC_TRACKS))


def ransac_options(threshold: float, settings: VoSettings, seed: int) -> RansacOptions:
    """Those of odometry, with a threshold in pixels."""
    iterations = (settings.ransac_iterations, 20 * settings.ransac_iterations)
    return RansacOptions(threshold, KERNEL * START_NOISE, seed, iterations, ROUGH)
