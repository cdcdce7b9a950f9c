"""Constant velocity, and what becomes of a covariance over a step."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.config import VoSettings
from fvslam_graph.vo.motion_model import ConstantVelocity, compose_covariance

SETTINGS = VoSettings()
TWIST = np.array([0.3, -0.2, 0.5, 1.0, -2.0, 4.0])  # rad/s, m/s


def moving(log_variance: float = 0.0) -> ConstantVelocity:
    model = ConstantVelocity(SETTINGS)
    model.observe(gtsam.Pose3.Expmap(0.1 * TWIST), 0.1, log_variance)
    return model


def test_a_constant_twist_carries_on():
    model = moving()
    assert model.twist == pytest.approx(TWIST, abs=1e-12)
    for seconds in (0.0, 0.1, 0.35):
        assert model.predict(seconds)[0].equals(gtsam.Pose3.Expmap(seconds * TWIST), 1e-12)
    twice = model.predict(0.1)[0].compose(model.predict(0.1)[0])
    assert twice.equals(model.predict(0.2)[0], 1e-12)


def test_uncertainty_is_that_of_the_accelerations():
    covariance = moving().predict(0.2)[1]
    assert np.sqrt(np.diag(covariance)) == pytest.approx(
        0.5 * 0.2**2 * np.repeat([SETTINGS.max_angular_acceleration, SETTINGS.max_acceleration], 3)
    )
    assert moving().predict(0.4)[1] == pytest.approx(16 * covariance)


def test_a_camera_that_stands():
    assert ConstantVelocity(SETTINGS).predict(1.0)[0].equals(gtsam.Pose3(), 0)
    assert ConstantVelocity(SETTINGS).distance(1.0) is None
    model = moving()
    model.stop()
    assert model.predict(1.0)[0].equals(gtsam.Pose3(), 0)
    assert model.distance(1.0) is None


def test_distance():
    scale = moving(log_variance=0.01).distance(0.3)
    metres = 0.3 * np.linalg.norm(TWIST[3:])
    assert scale.metres == pytest.approx(metres)
    # Relative to the distance, what the acceleration may add to it.
    assert scale.variance == pytest.approx(0.01 + (0.5 * SETTINGS.max_acceleration * 0.3**2 / metres) ** 2)


def some_covariance(seed: int, size: float) -> np.ndarray:
    mixing = size * np.random.default_rng(seed).standard_normal((6, 6))
    return mixing @ mixing.T


def test_compose_covariance_by_finite_differences():
    a_T_b = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.5, -0.4, 1.0])), np.array([3.0, -2.0, 1.0]))
    b_T_c = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([-0.3, 0.8, 0.2])), np.array([1.0, 5.0, -2.0]))
    a_T_c = a_T_b.compose(b_T_c)
    first, second = some_covariance(0, 0.1), some_covariance(1, 0.05)

    def change(at_b: np.ndarray, at_c: np.ndarray) -> np.ndarray:
        moved = a_T_b.compose(gtsam.Pose3.Expmap(at_b)).compose(b_T_c.compose(gtsam.Pose3.Expmap(at_c)))
        return gtsam.Pose3.Logmap(a_T_c.between(moved))

    step, none = 1e-6, np.zeros(6)
    by_b = np.column_stack([(change(step * e, none) - change(-step * e, none)) / (2 * step) for e in np.eye(6)])
    by_c = np.column_stack([(change(none, step * e) - change(none, -step * e)) / (2 * step) for e in np.eye(6)])
    expected = by_b @ first @ by_b.T + by_c @ second @ by_c.T
    composed = compose_covariance(first, b_T_c, second)
    assert composed == pytest.approx(expected, rel=1e-6, abs=1e-8)
    assert np.array_equal(composed, composed.T)


def test_without_a_step_nothing_changes():
    covariance = some_covariance(2, 1.0)
    assert compose_covariance(covariance, gtsam.Pose3(), np.zeros((6, 6))) == pytest.approx(covariance)
