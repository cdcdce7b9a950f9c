"""Relative pose of two views: exact without noise, and as uncertain as it says with noise."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.stats import chi2

from fvslam_graph.config import VoSettings
from fvslam_graph.evaluation.nees import nees_band
from fvslam_graph.features.tracks import Tracks
from fvslam_graph.vo.two_view import estimate_two_view, m_estimator_covariance, rays, sampson

SETTINGS = VoSettings()
FORWARD = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.01, 0.03, -0.02])), np.array([0.2, 0.05, 1.0]))
SIDEWAYS = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.02, -0.01, 0.1])), np.array([1.0, 0.1, 0.1]))
MOTIONS = pytest.mark.parametrize("motion", [FORWARD, SIDEWAYS], ids=["forward", "sideways"])


def essential(pose: gtsam.Pose3) -> gtsam.EssentialMatrix:
    return gtsam.EssentialMatrix(pose.rotation(), gtsam.Unit3(pose.translation()))


def error_of(estimate, motion: gtsam.Pose3) -> np.ndarray:
    """In the tangent of the estimate, (5,) radians."""
    return gtsam.EssentialMatrix(estimate.rotation, gtsam.Unit3(estimate.direction)).localCoordinates(essential(motion))


@MOTIONS
def test_exact_without_noise(camera, two_views, motion):
    scene = two_views(motion)
    estimate = estimate_two_view(scene.tracks, camera, SETTINGS, seed=0)
    assert estimate.inliers.all() and len(estimate.inliers) == len(scene.tracks) > 250
    assert np.abs(error_of(estimate, motion)).max() < 1e-9  # measured 1e-15
    assert estimate.direction == pytest.approx(motion.translation() / np.linalg.norm(motion.translation()), abs=1e-9)


@MOTIONS
def test_sampson_distance_is_that_of_the_textbook(camera, two_views, motion):
    """Hartley and Zisserman eq. 11.9 with the fundamental matrix, in pixels."""
    tracks = two_views(motion, noise=2.0).tracks
    K_inverse = np.linalg.inv(camera.K)
    t = motion.translation() / np.linalg.norm(motion.translation())
    skew = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    F = K_inverse.T @ skew @ motion.rotation().matrix() @ K_inverse
    ones = np.ones((len(tracks), 1))
    previous, current = np.hstack([tracks.reference, ones]), np.hstack([tracks.current, ones])
    lines, back = current @ F.T, previous @ F
    expected = (previous * lines).sum(axis=1) / np.sqrt((lines[:, :2] ** 2 + back[:, :2] ** 2).sum(axis=1))
    distance, _ = sampson(rays(camera, tracks.reference), rays(camera, tracks.current), motion.rotation(), t, camera.fx)
    assert distance == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert 1.0 < distance.std() < 3.0


@MOTIONS
def test_sampson_jacobian_by_finite_differences(camera, two_views, motion):
    tracks = two_views(motion).tracks
    previous, current = rays(camera, tracks.reference), rays(camera, tracks.current)

    def distances(step: np.ndarray) -> np.ndarray:
        moved = essential(motion).retract(step)
        return sampson(previous, current, moved.rotation(), moved.direction().point3(), camera.fx)[0]

    _, jacobian = sampson(previous, current, motion.rotation(), essential(motion).direction().point3(), camera.fx)
    step = 1e-6
    numeric = np.column_stack([(distances(step * e) - distances(-step * e)) / (2 * step) for e in np.eye(5)])
    assert np.abs(jacobian - numeric).max() < 1e-6 * np.abs(numeric).max()
    assert np.linalg.matrix_rank(jacobian) == 5


def nees_of(camera, two_views, motion, seeds: int, **options: float) -> np.ndarray:
    values = []
    for seed in range(seeds):
        estimate = estimate_two_view(two_views(motion, seed=seed, **options).tracks, camera, SETTINGS, seed)
        error = error_of(estimate, motion)
        assert np.abs(estimate.covariance - estimate.covariance.T).max() == 0
        values.append(error @ np.linalg.solve(estimate.covariance, error))
    return np.array(values)


@MOTIONS
def test_covariance_is_honest(camera, two_views, motion):
    values = nees_of(camera, two_views, motion, 100, noise=0.1)
    low, high = nees_band(5, len(values))
    assert low < values.mean() < high  # measured 5.2 and 4.8


@MOTIONS
def test_covariance_is_honest_among_outliers(camera, two_views, motion):
    """Mostly: now and then an outlier lies on its epipolar line and is believed."""
    values = nees_of(camera, two_views, motion, 100, noise=0.1, outliers=0.2)
    assert 3.6 < np.median(values) < 5.2  # of chi-square with 5 degrees of freedom: 4.35; measured 4.1 and 4.5
    assert 0.84 < np.mean(values < chi2.ppf(0.95, 5)) < 0.98  # measured 0.90 and 0.89


@MOTIONS
def test_covariance_where_the_noise_is_that_of_the_loss(camera, two_views, motion):
    """A third of the residuals is cut by the loss and some by the threshold: a little optimistic."""
    values = nees_of(camera, two_views, motion, 100, noise=0.3)
    assert nees_band(5, len(values))[0] < values.mean() < 8.5  # measured 7.3 and 6.5


def test_outliers_are_found(camera, two_views):
    scene = two_views(FORWARD, noise=0.1, outliers=0.2)
    estimate = estimate_two_view(scene.tracks, camera, SETTINGS, seed=0)
    assert 0.3 < scene.is_outlier.mean() < 0.4  # wrong in one image or the other
    assert estimate.inliers[~scene.is_outlier].mean() > 0.99
    assert estimate.inliers[scene.is_outlier].mean() < 0.06  # by chance on the epipolar line
    assert 1e-5 < np.abs(error_of(estimate, FORWARD)).max() < 0.005


@pytest.mark.parametrize("noise", [0.05, 0.2])
def test_the_noise_is_told_by_the_inliers(camera, two_views, noise):
    scene = two_views(FORWARD)
    error = noise * np.random.default_rng(0).standard_normal(scene.tracks.current.shape)
    tracks = replace(scene.tracks, current=scene.tracks.current + error)
    assert estimate_two_view(tracks, camera, SETTINGS, 0).noise == pytest.approx(noise, rel=0.1)


def test_the_same_seed_gives_the_same_bits(camera, two_views):
    tracks = two_views(FORWARD, noise=0.3, outliers=0.2).tracks
    first, again = (estimate_two_view(tracks, camera, SETTINGS, seed=7) for _ in range(2))
    assert np.array_equal(first.direction, again.direction)
    assert np.array_equal(first.rotation.matrix(), again.rotation.matrix())
    assert np.array_equal(first.covariance, again.covariance)


def test_nothing_to_go_by(camera, two_views):
    tracks = two_views(FORWARD).tracks
    assert estimate_two_view(Tracks.none(), camera, SETTINGS, 0) is None
    assert estimate_two_view(tracks[np.arange(SETTINGS.min_inliers - 1)], camera, SETTINGS, 0) is None
    assert estimate_two_view(tracks[np.zeros(50, int)], camera, SETTINGS, 0) is None
    rng = np.random.default_rng(0)
    anywhere = Tracks(np.arange(40), rng.uniform(0, 480, (40, 2)), rng.uniform(0, 480, (40, 2)))
    assert estimate_two_view(anywhere, camera, SETTINGS, 0) is None


def test_covariance_of_least_squares():
    """Where the loss is wide, that of ordinary least squares with the noise of the residuals themselves."""
    rng = np.random.default_rng(0)
    jacobian = rng.standard_normal((20_000, 3)) * (1.0, 2.0, 5.0)
    covariance = m_estimator_covariance(0.5 * rng.standard_normal(20_000), jacobian, loss_scale=1e3)
    assert covariance == pytest.approx(0.25 * np.linalg.inv(jacobian.T @ jacobian), rel=0.05, abs=1e-7)


def test_residuals_that_determine_nothing_have_no_covariance():
    rng = np.random.default_rng(0)
    jacobian, residual = rng.standard_normal((20, 3)), 0.1 * rng.standard_normal(20)
    assert m_estimator_covariance(residual, jacobian, 0.3) is not None
    assert m_estimator_covariance(residual[:3], jacobian[:3], 0.3) is None
    assert m_estimator_covariance(residual, jacobian[:, [0, 1, 1]], 0.3) is None
    assert m_estimator_covariance(residual + 10, jacobian, 0.3) is None  # all are outliers
