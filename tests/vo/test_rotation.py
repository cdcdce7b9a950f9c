"""Rotation alone: exact where there is nothing else, hardly moved by near points and wrong matches."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.vo.rotation import fit_rotation, motion_given_rotation, near_parallax

TURN = gtsam.Rot3.Expmap(np.array([0.02, -0.05, 0.1]))


def angle(a: gtsam.Rot3, b: gtsam.Rot3) -> float:
    return float(np.linalg.norm(gtsam.Rot3.Logmap(a.between(b))))


def matched(camera, scene):
    return camera.rays(scene.tracks.keyframe), camera.rays(scene.tracks.current)


@pytest.mark.parametrize("size", [1.0, 0.01, 0.0])
def test_exact_for_a_pure_rotation(camera, two_views, size):
    turn = gtsam.Rot3.Expmap(size * gtsam.Rot3.Logmap(TURN))
    rotation, residual = fit_rotation(*matched(camera, two_views(gtsam.Pose3(turn, np.zeros(3)))), camera.fx)
    assert angle(rotation, turn) < 1e-12
    assert residual.max() < 1e-9


def test_residual_is_the_image_motion_that_is_left(camera):
    previous = np.array([[0.0, 0.0, 1.0]] * 5 + [[0.1, 0.0, 1.0]] * 5 + [[0.0, 0.1, 1.0]] * 5)
    current = previous.copy()
    current[0, 0] += 2 / camera.fx  # two pixels aside, at the centre of the image
    rotation, residual = fit_rotation(previous, current, camera.fx)
    assert residual[0] == pytest.approx(2.0, abs=0.05)
    assert residual[1:].max() < 0.05
    assert angle(rotation, gtsam.Rot3()) < 5e-4


def test_wrong_matches_do_not_decide(camera, two_views):
    scene = two_views(gtsam.Pose3(TURN, np.zeros(3)), noise=0.2, outliers=0.1)
    assert 0.15 < scene.is_outlier.mean() < 0.25
    rotation, residual = fit_rotation(*matched(camera, scene), camera.fx)
    assert 1e-6 < angle(rotation, TURN) < 4e-4  # measured 1.2e-4
    assert np.median(residual[~scene.is_outlier]) < 0.6
    assert np.median(residual[scene.is_outlier]) > 50


def test_a_translation_is_left_unexplained(camera, two_views):
    """Most points are far: the near ones show the parallax and do not turn the camera."""
    near = two_views(gtsam.Pose3(TURN, np.array([0.2, 0.0, 0.0])), near=3.0, far=6.0, landmarks=60)
    far = two_views(gtsam.Pose3(TURN, np.array([0.2, 0.0, 0.0])), near=500.0, far=1000.0, landmarks=300)
    previous, current = (np.vstack(both) for both in zip(matched(camera, near), matched(camera, far), strict=True))
    rotation, residual = fit_rotation(previous, current, camera.fx)
    assert 1e-6 < angle(rotation, TURN) < 1e-3  # measured 3.0e-4
    assert residual[: len(near.tracks)].min() > 10
    assert np.median(residual) < 0.5


def test_the_result_is_a_rotation_even_for_nonsense():
    rng = np.random.default_rng(0)
    ones = np.ones((30, 1))
    rotation, residual = fit_rotation(
        np.hstack([rng.normal(size=(30, 2)), ones]), np.hstack([rng.normal(size=(30, 2)), ones]), 450.0
    )
    assert np.linalg.det(rotation.matrix()) == pytest.approx(1.0)
    assert np.isfinite(residual).all()


def test_near_points_tell_a_parallax_that_the_horizon_hides():
    noise = np.abs(np.random.default_rng(0).standard_normal(200))
    assert near_parallax(noise) == pytest.approx(np.median(noise))
    near = np.where(np.arange(200) % 4 == 0, 30.0, noise)
    assert near_parallax(near) == pytest.approx(15.0)


@pytest.mark.parametrize("step", [(0.0, 0.0, 0.8), (0.3, -0.1, -0.5), (0.5, 0.0, 0.0)])
def test_a_direction_beside_the_rotation_of_the_horizon(step):
    """One point in five is near, and one in a hundred is a wrong match."""
    rng = np.random.default_rng(0)
    true = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.01, -0.02, 0.005), np.array(step))
    depths = np.where(np.arange(400) % 5 == 0, rng.uniform(8, 20, 400), 3000.0)
    previous = np.column_stack([rng.uniform(-0.6, 0.6, (400, 2)), np.ones(400)])
    current = true.transformTo((depths[:, None] * previous).T).T
    current /= current[:, 2:]
    current[:, :2] += rng.normal(0, 0.2 / 450, (400, 2))
    current[3::100, :2] += rng.normal(0, 0.1, (4, 2))
    found = motion_given_rotation(fit_rotation(previous, current, 450.0)[0], previous, current)
    assert np.linalg.norm(gtsam.Rot3.Logmap(true.rotation().between(found.rotation()))) < 2e-3
    assert found.translation() @ step > 0.95 * np.linalg.norm(step)
