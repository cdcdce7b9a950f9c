"""Constant velocity."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import VoSettings
from fvslam_graph.vo.motion_model import ConstantVelocity

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
        assert model.predict(seconds).mean.equals(gtsam.Pose3.Expmap(seconds * TWIST), 1e-12)
    twice = model.predict(0.1).mean.compose(model.predict(0.1).mean)
    assert twice.equals(model.predict(0.2).mean, 1e-12)


def test_uncertainty_is_that_of_the_accelerations():
    """Since the middle of the motion that the velocity was measured over, 0.05 s ago."""
    accelerations = np.repeat([SETTINGS.max_angular_acceleration, SETTINGS.max_acceleration], 3)
    covariance = moving().predict(0.2).covariance
    assert np.sqrt(np.diag(covariance)) == pytest.approx((0.05 + 0.1) * 0.2 * accelerations)


def test_a_velocity_ages():
    model = moving()
    model.coast(1.0)
    assert np.sqrt(np.diag(model.predict(0.1).covariance))[5] == pytest.approx(SETTINGS.max_acceleration * 1.1 * 0.1)
    assert model.distance(0.1).variance > 10 * moving().distance(0.1).variance


def test_accelerations_are_learnt():
    rng, smooth, rough = np.random.default_rng(0), moving(), moving()
    for _ in range(300):
        smooth.observe(gtsam.Pose3.Expmap(0.1 * TWIST), 0.1, 0.0)
        jolt = rng.standard_normal(6)
        rough.observe(gtsam.Pose3.Expmap(0.1 * (TWIST + jolt)), 0.1, 0.0)
    prior = moving().accelerations
    assert np.all(smooth.accelerations < 0.5 * prior) and np.all(smooth.accelerations > 0.1 * prior)
    assert np.all(rough.accelerations > 3 * prior)  # the velocity changes by 14 m/s^2


def test_one_wrong_motion_teaches_little():
    model = moving()
    model.observe(gtsam.Pose3.Expmap(-10 * TWIST), 0.1, 0.0)
    assert np.all(model.accelerations < 1.3 * moving().accelerations)


def test_a_camera_that_stands():
    assert ConstantVelocity(SETTINGS).predict(1.0).mean.equals(gtsam.Pose3(), 0)
    assert ConstantVelocity(SETTINGS).distance(1.0) is None
    model = moving()
    model.stop()
    assert model.predict(1.0).mean.equals(gtsam.Pose3(), 0)
    assert model.distance(1.0) is None


def test_distance():
    scale = moving(log_variance=0.01).distance(0.3)
    metres = 0.3 * np.linalg.norm(TWIST[3:])
    assert scale.metres == pytest.approx(metres)
    # Relative to the distance, what the acceleration may add to it.
    assert scale.variance == pytest.approx(0.01 + (SETTINGS.max_acceleration * (0.05 + 0.15) * 0.3 / metres) ** 2)
