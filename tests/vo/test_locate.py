"""Pose among points of known depth."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.config import VoSettings
from fvslam_graph.evaluation.nees import nees_band
from fvslam_graph.vo.locate import locate, reprojection

SETTINGS = VoSettings()
MOTION = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.01, 0.03, -0.02])), np.array([0.05, 0.02, 0.1]))


def test_exact_without_noise(camera, two_views):
    scene = two_views(MOTION)
    ref_T_cur, covariance, inliers = locate(scene.points, scene.tracks.current, camera, SETTINGS, seed=0)
    assert inliers.all()
    assert np.abs(gtsam.Pose3.Logmap(ref_T_cur.between(MOTION))).max() < 1e-9  # measured 1e-14
    assert np.abs(covariance).max() < 1e-12


def test_reprojection_jacobian_by_finite_differences(camera, two_views):
    scene = two_views(MOTION, noise=1.0)

    def residuals(change: np.ndarray) -> np.ndarray:
        seen = MOTION.retract(change).transformTo(scene.points.T).T
        return reprojection(seen, scene.tracks.current, camera)[0]

    seen = MOTION.transformTo(scene.points.T).T
    residual, jacobian = reprojection(seen, scene.tracks.current, camera)
    assert residual.reshape(-1, 2) == pytest.approx(camera.project(seen) - scene.tracks.current)
    step = 1e-6
    numeric = np.column_stack([(residuals(step * e) - residuals(-step * e)) / (2 * step) for e in np.eye(6)])
    assert np.abs(jacobian - numeric).max() < 1e-6 * np.abs(numeric).max()


@pytest.mark.parametrize("outliers", [0.0, 0.2])
def test_covariance_is_honest(camera, two_views, outliers):
    values = []
    for seed in range(100):
        scene = two_views(MOTION, noise=0.1, outliers=outliers, seed=seed)
        ref_T_cur, covariance, _ = locate(scene.points, scene.tracks.current, camera, SETTINGS, seed)
        error = gtsam.Pose3.Logmap(ref_T_cur.between(MOTION))
        assert np.abs(covariance - covariance.T).max() == 0
        values.append(error @ np.linalg.solve(covariance, error))
    low, high = nees_band(6, len(values))
    assert low < np.mean(values) < high  # measured 5.8 and 6.2


def test_covariance_holds_the_errors_that_points_share(camera, two_views):
    shared_sigma, honest, unaware = 0.02, [], []
    for seed in range(100):
        scene = two_views(MOTION, noise=0.1, seed=seed)
        # All depths err with where the points are in the image, as they do by a wrong direction of travel.
        pattern = np.column_stack([camera.normalize(scene.tracks.reference), np.ones(len(scene.points))])
        shared = shared_sigma * scene.points[:, :, None] * pattern[:, None]
        points = scene.points + shared @ np.random.default_rng(seed).standard_normal(3)
        for values, told in ((honest, shared), (unaware, None)):
            found, covariance, _ = locate(points, scene.tracks.current, camera, SETTINGS, seed, told)
            error = gtsam.Pose3.Logmap(found.between(MOTION))
            values.append(error @ np.linalg.solve(covariance, error))
    low, high = nees_band(6, len(honest))
    assert low < np.mean(honest) < high
    assert np.mean(unaware) > 2 * high


def test_outliers_are_found(camera, two_views):
    scene = two_views(MOTION, noise=0.1, outliers=0.2)
    ref_T_cur, _, inliers = locate(scene.points, scene.tracks.current, camera, SETTINGS, seed=0)
    wrong = np.linalg.norm(camera.project(MOTION.transformTo(scene.points.T).T) - scene.tracks.current, axis=1) > 3
    assert 0.15 < wrong.mean() < 0.25
    assert not inliers[wrong].any()
    assert inliers[~wrong].mean() > 0.99
    assert 1e-6 < np.abs(gtsam.Pose3.Logmap(ref_T_cur.between(MOTION))).max() < 1e-3  # measured 1.7e-4


def test_nothing_to_go_by(camera, two_views):
    scene = two_views(MOTION)
    few = SETTINGS.min_inliers - 1
    assert locate(scene.points[:few], scene.tracks.current[:few], camera, SETTINGS, 0) is None
    assert locate(np.empty((0, 3)), np.empty((0, 2)), camera, SETTINGS, 0) is None
    rng = np.random.default_rng(0)
    anywhere = rng.uniform(0, 480, (len(scene.points), 2))
    assert locate(scene.points, anywhere, camera, SETTINGS, 0) is None
    same = np.repeat(scene.points[:1], 40, axis=0)
    assert locate(same, camera.project(same), camera, SETTINGS, 0) is None
    line = np.column_stack([np.linspace(-1, 1, 40), np.zeros(40), np.full(40, 5.0)])
    assert locate(line, camera.project(line), camera, SETTINGS, 0) is None
