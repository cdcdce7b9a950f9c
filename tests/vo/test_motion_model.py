"""Constant velocity."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import VoSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.vo.motion_model import ConstantVelocity

SETTINGS = VoSettings()
TWIST = np.array([0.3, -0.2, 0.5, 1.0, -2.0, 4.0])  # rad/s, m/s


def motion(twist: np.ndarray, covariance: np.ndarray | float = 0.0) -> GaussianPose:
    """Over a tenth of a second."""
    return GaussianPose(gtsam.Pose3.Expmap(0.1 * twist), covariance * np.eye(6))


def moving(log_variance: float = 0.0) -> ConstantVelocity:
    model = ConstantVelocity(SETTINGS)
    model.observe(motion(TWIST).with_scale_variance(log_variance), 0.1, log_variance)
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


def test_a_velocity_is_as_uncertain_as_the_motion_that_told_it():
    """But for its scale, which what it is held against has as well."""
    model = ConstantVelocity(SETTINGS)
    model.observe(motion(TWIST, 1e-4).with_scale_variance(0.5), 0.1, 0.5)
    added = model.predict(0.2).covariance - moving(0.5).predict(0.2).covariance
    assert added == pytest.approx(4e-4 * np.eye(6), abs=1e-6)


def test_a_velocity_ages():
    model = moving()
    model.coast(1.0)
    assert np.sqrt(np.diag(model.predict(0.1).covariance))[5] == pytest.approx(SETTINGS.max_acceleration * 1.1 * 0.1)
    assert model.distance(0.1).variance > 10 * moving().distance(0.1).variance


def test_accelerations_are_learnt():
    rng, smooth, rough = np.random.default_rng(0), moving(), moving()
    for _ in range(300):
        smooth.observe(motion(TWIST), 0.1, 0.0)
        jolt = rng.standard_normal(6)
        rough.observe(motion(TWIST + jolt), 0.1, 0.0)
    prior = moving().accelerations
    assert np.all(smooth.accelerations < 0.5 * prior) and np.all(smooth.accelerations > 0.1 * prior)
    assert np.all(rough.accelerations > 3 * prior)  # the velocity changes by 14 m/s^2


def test_one_wrong_motion_teaches_little():
    model = moving()
    model.observe(motion(-100 * TWIST), 0.1, 0.0)
    assert np.all(model.accelerations < 1.3 * moving().accelerations)


def test_a_camera_that_stands():
    assert ConstantVelocity(SETTINGS).predict(1.0).mean.equals(gtsam.Pose3(), 0)
    assert ConstantVelocity(SETTINGS).distance(1.0) is None
    model = moving()
    model.stop()
    assert model.predict(1.0).mean.equals(gtsam.Pose3(), 0)
    assert model.distance(1.0) is None
    # An image may have been delivered twice, and the camera go on; of two, nobody thinks so.
    for deviations in (1.0, 0.0):
        accelerated = np.repeat((0.1 / 2 * 0.1 * moving().accelerations[[0, 3]]) ** 2, 3)
        expected = np.diag(accelerated) + deviations * np.outer(0.1 * TWIST, 0.1 * TWIST)
        assert model.predict(0.1).covariance == pytest.approx(expected)
        model.stop()


def test_distance():
    scale = moving(log_variance=0.01).distance(0.3)
    metres = 0.3 * np.linalg.norm(TWIST[3:])
    assert scale.metres == pytest.approx(metres)
    # Relative to the distance, what the acceleration may add to it.
    assert scale.variance == pytest.approx(0.01 + (SETTINGS.max_acceleration * (0.05 + 0.15) * 0.3 / metres) ** 2)


def test_damaged_stamps_leave_numbers_that_are_finite():
    model = moving(log_variance=0.01)
    model.coast(1e300)
    for seconds in (1e300, 0.1):
        assert np.isfinite(model.predict(seconds).covariance).all()
        assert np.isfinite(model.distance(seconds).variance)
