"""Pose among points of known depth, well known or hardly."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import VoSettings
from fvslam_graph.core.inverse_depths import COMMON_ERRORS, InverseDepths
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.evaluation.nees import nees_band
from fvslam_graph.vo.absolute_pose import estimate_absolute_pose, refine_absolute_pose, with_known_depths
from fvslam_graph.vo.depth import triangulate
from fvslam_graph.vo.epipolar import MatchedRays
from fvslam_graph.vo.relative_pose import estimate_relative_pose
from fvslam_graph.vo.reprojection import reprojection_errors

from .conftest import recalibrated

SETTINGS = VoSettings()
MOTION = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.01, 0.03, -0.02])), np.array([0.05, 0.02, 0.1]))
SHORT = gtsam.Pose3(MOTION.rotation(), 0.3 * MOTION.translation())  # of little parallax
NEAR = MOTION.retract(np.array([0.002, -0.001, 0.003, 0.004, 0.002, -0.005]))


def depths_of(scene, sigma, seed: int = 0, common=None) -> InverseDepths:
    """Known with errors of these relative deviations, and with errors that all share."""
    rng = np.random.default_rng(seed)
    values, sigma = 1 / scene.points[:, 2], np.broadcast_to(sigma, len(scene.points))
    common = np.zeros((len(values), COMMON_ERRORS)) if common is None else common
    errors = np.where(np.isfinite(sigma), sigma, 0.0) * rng.standard_normal(len(values)) * values
    off = common @ rng.standard_normal(COMMON_ERRORS)
    return InverseDepths(scene.tracks.ids, values + errors + off, sigma * values, common, np.zeros((len(values), 2)))


def hardly_known(depths: InverseDepths) -> InverseDepths:
    return depths[np.isfinite(depths.sigmas)].of(depths.ids)


def refined(camera, scene, depths):
    return refine_absolute_pose(NEAR, camera.rays(scene.tracks.keyframe), scene.tracks, depths, camera)


def unit_depths(camera, scene, found) -> InverseDepths:
    matched = MatchedRays.of(camera, scene.tracks)
    return triangulate(scene.tracks.ids, matched, found.rotation, found.direction, found.noise)


def nees_of(found) -> float:
    error, covariance = gtsam.Pose3.Logmap(found.pose.mean.between(MOTION)), found.pose.covariance
    assert np.abs(covariance - covariance.T).max() == 0
    return float(error @ np.linalg.solve(covariance, error))


def test_exact_without_noise(camera, two_views):
    scene = two_views(MOTION)
    located = estimate_absolute_pose(scene.points, scene.tracks.current, camera, SETTINGS, seed=0)
    assert located.equals(MOTION, 1e-6)
    found = refined(camera, scene, depths_of(scene, 0.0))
    assert found.agree.all()
    assert np.abs(gtsam.Pose3.Logmap(found.pose.mean.between(MOTION))).max() < 1e-9
    assert np.abs(found.pose.covariance).max() < 1e-12


@pytest.mark.parametrize("sigma", [0.0, 0.02, np.inf])
def test_jacobian_by_finite_differences(camera, two_views, sigma):
    scene = two_views(MOTION)
    ray, depths = camera.rays(scene.tracks.keyframe), depths_of(scene, 0.0)
    depths = InverseDepths.independent(depths.ids, depths.values, sigma * depths.values)

    def values(change: np.ndarray) -> np.ndarray:
        return reprojection_errors(MOTION.retract(change), ray, scene.tracks, depths, camera, 0.5).values

    jacobian = reprojection_errors(MOTION, ray, scene.tracks, depths, camera, 0.5).J_pose
    step = 1e-6
    numeric = np.stack([(values(step * e) - values(-step * e)) / (2 * step) for e in np.eye(6)], axis=2)
    assert np.abs(jacobian - numeric).max() < 1e-5 * np.abs(numeric).max()


def test_a_point_of_unknown_depth_tells_what_it_tells_in_two_views(camera, two_views):
    """The distance from its epipolar line, at any depth that is assumed; nothing along that."""
    scene = two_views(MOTION, noise=0.5)
    ray, across = camera.rays(scene.tracks.keyframe), []
    for factor in (0.5, 1.0, 3.0):
        values = factor / scene.points[:, 2]
        unknown = InverseDepths.independent(scene.tracks.ids, values, np.full(len(values), np.inf))
        errors = reprojection_errors(MOTION, ray, scene.tracks, unknown, camera, 0.5)
        assert np.abs(errors.values[:, 1]).max() < 1e-3
        across.append(errors.values[:, 0])
    assert np.ptp(across, axis=0).max() < 1e-6


def test_errors_are_whitened(camera, two_views):
    """Covariances of displacements, of depths and of both, by many draws: the identity."""
    rng = np.random.default_rng(0)
    scene = two_views(MOTION)
    roots = rng.standard_normal((len(scene.points), 2, 2))
    tracks = replace(scene.tracks, covariances=roots @ roots.mT + 0.1 * np.eye(2))
    root = np.linalg.cholesky(tracks.covariances)
    ray, exact = camera.rays(tracks.keyframe), 1 / scene.points[:, 2]
    sigma, drawn = 0.1 * exact, []
    for _ in range(40):
        noise = (root @ rng.standard_normal((len(exact), 2, 1)))[:, :, 0]
        moved = replace(tracks, current=tracks.current + 0.2 * noise)
        depths = InverseDepths.independent(tracks.ids, exact + sigma * rng.standard_normal(len(exact)), sigma)
        drawn.append(reprojection_errors(MOTION, ray, moved, depths, camera, 0.2).values)
    assert np.cov(np.concatenate(drawn).T) == pytest.approx(np.eye(2), abs=0.05)


@pytest.mark.parametrize("sigma", [0.0, 0.03, "some"])
@pytest.mark.parametrize("outliers", [0.0, 0.2])
def test_covariance_is_consistent(camera, two_views, outliers, sigma):
    """Whether all depths are known, none well, or half of them not at all."""
    values = []
    for seed in range(100):
        scene = two_views(MOTION, noise=0.1, outliers=outliers, seed=seed)
        spread = np.where(np.arange(len(scene.points)) % 2, np.inf, 0.01) if sigma == "some" else sigma
        values.append(nees_of(refined(camera, scene, hardly_known(depths_of(scene, spread, seed)))))
    low, high = nees_band(6, len(values))
    if outliers:  # now and then one is believed
        assert 4.0 < np.median(values) < 7.0  # of chi-square with 6 degrees of freedom: 5.35
    else:
        assert 0.8 * low < np.mean(values) < 1.15 * high


def test_covariance_holds_the_errors_that_points_share(camera, two_views):
    consistent, unaware = [], []
    for seed in range(100):
        scene = two_views(MOTION, noise=0.1, seed=seed)
        # All depths err with where the points are in the image, as they do by a wrong direction of travel.
        ray = camera.rays(scene.tracks.keyframe)
        common = np.zeros((len(ray), COMMON_ERRORS))
        common[:, :3] = 0.02 * ray / scene.points[:, 2:]
        told = depths_of(scene, 0.001, seed, common)
        untold = InverseDepths.independent(told.ids, told.values, told.sigmas)
        consistent.append(nees_of(refined(camera, scene, told)))
        unaware.append(nees_of(refined(camera, scene, untold)))
    low, high = nees_band(6, len(consistent))
    assert 0.8 * low < np.mean(consistent) < 1.1 * high
    assert np.mean(unaware) > 2 * high


def by_two_views(camera, scene):
    return estimate_relative_pose(scene.tracks, camera, SETTINGS, seed=0, expected=[MOTION, SHORT])


def direction_nees(found) -> tuple[float, float]:
    """NEES of rotation and direction, and by what angle the direction errs."""
    truth = gtsam.EssentialMatrix(SHORT.rotation(), gtsam.Unit3(SHORT.translation()))
    error = truth.localCoordinates(gtsam.EssentialMatrix(found.rotation, gtsam.Unit3(found.direction)))
    return float(error @ np.linalg.solve(found.covariance, error)), float(np.linalg.norm(error[3:]))


def test_known_depths_help_two_views(camera, two_views):
    """Depths that are known within 3 %, where there is little parallax: two views alone may be far off."""
    values, errors, turns = [], [], []
    for seed in range(60):
        scene = two_views(SHORT, noise=0.1, seed=seed)
        alone = by_two_views(camera, scene)
        both = with_known_depths(
            alone, scene.tracks, unit_depths(camera, scene, alone), depths_of(scene, 0.03, seed), camera
        )
        values.append(direction_nees(both)[0])
        errors.append([direction_nees(found)[1] for found in (both, alone)])
        turns.append([np.trace(found.covariance[:3, :3]) for found in (both, alone)])
    low, high = nees_band(5, len(values))
    assert 0.8 * low < np.mean(values) < 1.1 * high
    assert np.mean(errors, axis=0)[0] < 0.9 * np.mean(errors, axis=0)[1]
    assert np.median(turns, axis=0)[0] < 0.8 * np.median(turns, axis=0)[1]


def test_depths_of_something_else_do_not_help_two_views(camera, two_views):
    scene = two_views(MOTION, noise=0.1)
    alone = by_two_views(camera, scene)
    unit, depths = unit_depths(camera, scene, alone), depths_of(scene, 0.005)
    others = replace(depths, values=np.random.default_rng(0).permutation(depths.values))
    assert with_known_depths(alone, scene.tracks, unit, others, camera) is None
    assert with_known_depths(alone, scene.tracks, unit, depths[np.arange(5)], camera) is None


def test_points_of_unknown_depth_help(camera, two_views):
    """The rotation is less certain by some twenty known depths alone than with all others beside them."""
    scene = two_views(MOTION, noise=0.1)
    few = np.arange(len(scene.points)) % 15 == 0
    depths = depths_of(scene, np.where(few, 0.01, np.inf))
    alone = refine_absolute_pose(NEAR, camera.rays(scene.tracks.keyframe)[few], scene.tracks[few], depths[few], camera)
    together = refined(camera, scene, depths)
    turn = [np.trace(found.pose.covariance[:3, :3]) for found in (alone, together)]
    assert turn[1] < 0.3 * turn[0]
    assert together.agree.mean() > 0.99


def test_outliers_are_found(camera, two_views):
    scene = two_views(MOTION, noise=0.1, outliers=0.2)
    found = refined(camera, scene, depths_of(scene, 0.0))
    assert 0.3 < scene.is_outlier.mean() < 0.4  # wrong in one image or the other
    assert found.agree[scene.is_outlier].mean() < 0.02
    assert found.agree[~scene.is_outlier].mean() > 0.99
    assert 1e-6 < np.abs(gtsam.Pose3.Logmap(found.pose.mean.between(MOTION))).max() < 1e-3


def test_nothing_to_go_by(camera, two_views):
    scene = two_views(MOTION)
    few = SETTINGS.min_inliers - 1
    assert estimate_absolute_pose(scene.points[:few], scene.tracks.current[:few], camera, SETTINGS, 0) is None
    assert estimate_absolute_pose(np.empty((0, 3)), np.empty((0, 2)), camera, SETTINGS, 0) is None
    rng = np.random.default_rng(0)
    anywhere = rng.uniform(0, 480, (len(scene.points), 2))
    assert estimate_absolute_pose(scene.points, anywhere, camera, SETTINGS, 0) is None
    same = np.zeros(40, int)
    again = scene._replace(tracks=scene.tracks[same], points=scene.points[same])
    assert refined(camera, again, depths_of(scene, 0.0)[same]) is None


@pytest.mark.parametrize(("column", "change"), [(0, (1e-4, 0.0)), (1, (0.0, 1e-4))])
def test_the_pose_changes_with_the_calibration_as_it_says(camera, two_views, column, change):
    scene = two_views(MOTION, noise=0.1)
    depths = depths_of(scene, 0.02)
    tracks = scene.tracks
    other = Tracks.alike(tracks.ids, *(recalibrated(camera, at, *change) for at in (tracks.keyframe, tracks.current)))
    before, after = (
        refine_absolute_pose(NEAR, camera.rays(seen.keyframe), seen, depths, camera) for seen in (tracks, other)
    )
    moved = before.pose.mean.localCoordinates(after.pose.mean) / max(change)
    assert before.J_calibration[:, column] == pytest.approx(moved, rel=0.1, abs=0.03)
