"""Landmarks in inverse depth: directions, points, other cameras, and all derivatives."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.slam.inverse_depth import (
    angles,
    direction,
    hat,
    inverse_depth_seen_from,
    linearity_index,
    points_seen_from,
    scaled_points,
    to_points,
)

from .conftest import agrees, numeric

SEEDS = range(20)


def some(seed: int, count: int = 5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    anchor, pointing = rng.standard_normal((count, 3)), rng.uniform(-1.2, 1.2, (count, 2))
    return np.column_stack([anchor, pointing, rng.uniform(0.02, 1.0, count)])


def test_directions_follow_the_camera_axes():
    ahead, right, up = (
        direction(np.array([a]), np.array([e]))[0][0] for a, e in ((0, 0), (np.pi / 2, 0), (0, np.pi / 2))
    )
    assert ahead == pytest.approx([0, 0, 1])
    assert right == pytest.approx([1, 0, 0])
    assert up == pytest.approx([0, -1, 0])  # y is down


@pytest.mark.parametrize("seed", SEEDS)
def test_angles_are_the_inverse_of_directions(seed):
    pointing = some(seed)[:, 3:5]
    unit, _ = direction(*pointing.T)
    assert np.linalg.norm(unit, axis=1) == pytest.approx(np.ones(5))
    assert angles(3.7 * unit)[0] == pytest.approx(pointing, abs=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_derivatives_of_directions_and_angles(seed):
    pointing, vectors = some(seed)[:1, 3:5], some(seed)[:1, :3]
    assert agrees(direction(*pointing.T)[1][0], numeric(lambda e: direction(*(pointing + e).T)[0][0], 2))
    assert agrees(angles(vectors)[1][0], numeric(lambda e: angles(vectors + e)[0][0], 3))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("function", [scaled_points, to_points])
def test_derivatives_of_points(function, seed):
    landmark = some(seed, 1)
    assert agrees(function(landmark)[1][0], numeric(lambda e: function(landmark + e)[0][0], 6, 1e-7))


def test_both_kinds_of_points_agree():
    landmarks = some(0)
    scaled, _ = scaled_points(landmarks)
    points, _ = to_points(landmarks)
    assert scaled / landmarks[:, 5:] == pytest.approx(points)


def test_points_at_infinity_are_directions():
    landmark = some(1, 1)
    landmark[0, 5] = 0.0
    assert scaled_points(landmark)[0] == pytest.approx(direction(landmark[:, 3], landmark[:, 4])[0])
    assert np.isfinite(to_points(landmark)[0]).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_derivatives_of_a_step(seed):
    landmark, step = some(seed, 1), gtsam.Pose3.Expmap(0.5 * np.random.default_rng(seed).standard_normal(6))
    point, ray = landmark[:, :3], landmark[:, 3:]

    def points(J_motion: np.ndarray, J_point: np.ndarray) -> np.ndarray:
        pose = step.retract(J_motion)
        return points_seen_from(point + J_point, pose.rotation().matrix(), pose.translation())[0][0]

    def inverse_depth(J_motion: np.ndarray, J_ray: np.ndarray) -> np.ndarray:
        return inverse_depth_seen_from(ray + J_ray, step.retract(J_motion).rotation().matrix())[0][0]

    rotation = step.rotation().matrix()
    for moved, (_, J_motion, J_part) in (
        (points, points_seen_from(point, rotation, step.translation())),
        (inverse_depth, inverse_depth_seen_from(ray, rotation)),
    ):
        assert agrees(J_motion[0], numeric(lambda e, moved=moved: moved(e, np.zeros(3)), 6))
        assert agrees(J_part[0], numeric(lambda e, moved=moved: moved(np.zeros(6), e), 3))


def test_a_step_moves_landmarks_as_gtsam_does():
    landmarks, step = some(3), gtsam.Pose3.Expmap(np.array([0.2, -0.1, 0.3, 1.0, -2.0, 0.5]))
    anchors, _, _ = points_seen_from(landmarks[:, :3], step.rotation().matrix(), step.translation())
    assert anchors == pytest.approx(step.transformTo(landmarks[:, :3].T).T)
    inverse_depth, _, _ = inverse_depth_seen_from(landmarks[:, 3:], step.rotation().matrix())
    expected = step.transformTo(to_points(landmarks)[0].T).T
    assert to_points(np.hstack([anchors, inverse_depth]))[0] == pytest.approx(expected)


def test_linearity_index_by_hand():
    # Seen straight ahead from its anchor, 10 m away, known to 5 % of the inverse depth: 4 * 0.5 m / 10 m.
    landmark = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.1]])
    assert linearity_index(landmark, np.array([0.005])) == pytest.approx([0.2])
    # From the side, at a right angle, the error of the depth is across the view.
    landmark[0, :3] = [-10.0, 0.0, -10.0]
    assert linearity_index(landmark, np.array([0.005])) == pytest.approx([0.0], abs=1e-9)


def test_hat_is_the_cross_product():
    a, b = np.random.default_rng(0).standard_normal((2, 5, 3))
    assert np.einsum("nij,nj->ni", hat(a), b) == pytest.approx(np.cross(a, b))
