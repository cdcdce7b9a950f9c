"""Poses with covariances."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.gaussian_pose import GaussianPose, ScaledPose


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
    composed = GaussianPose(a_T_b, first).compose(GaussianPose(b_T_c, second))
    assert composed.mean.equals(a_T_c, 1e-12)
    assert composed.covariance == pytest.approx(expected, rel=1e-6, abs=1e-8)
    assert np.array_equal(composed.covariance, composed.covariance.T)


def test_without_a_step_nothing_changes():
    pose = GaussianPose(gtsam.Pose3.Expmap(np.arange(6.0)), some_covariance(2, 1.0))
    assert pose.compose(GaussianPose.identity()).covariance == pytest.approx(pose.covariance)


def test_inverse():
    pose = GaussianPose(gtsam.Pose3.Expmap(0.3 * np.arange(6.0)), some_covariance(3, 1.0))
    inverse, change = pose.inverse(), 1e-6 * np.eye(6)
    J_pose = np.column_stack([inverse.mean.localCoordinates(pose.mean.retract(e).inverse()) for e in change]) / 1e-6
    assert inverse.covariance == pytest.approx(J_pose @ pose.covariance @ J_pose.T, rel=1e-5, abs=1e-5)
    assert inverse.inverse().covariance == pytest.approx(pose.covariance)


def test_a_scale_that_is_not_known_is_an_uncertain_length():
    """By poses whose translations are stretched."""
    motion = GaussianPose(gtsam.Pose3(gtsam.Rot3.Yaw(0.3), np.array([1.0, 0.5, 2.0])), 1e-4 * np.eye(6))
    logs = 1e-4 * np.array([-1.0, 1.0])
    stretched = [gtsam.Pose3(motion.mean.rotation(), np.exp(log) * motion.mean.translation()) for log in logs]
    scale_covariance = motion.mean.localCoordinates(stretched[1]) - motion.mean.localCoordinates(stretched[0])
    scale_covariance /= logs[1] - logs[0]
    vague = motion.with_scale_variance(0.04)
    assert vague.mean.equals(motion.mean, 0)
    assert vague.covariance - motion.covariance == pytest.approx(
        0.04 * np.outer(scale_covariance, scale_covariance), abs=1e-8
    )
    assert vague.with_scale_variance(-0.04).covariance == pytest.approx(motion.covariance, abs=1e-12)


def path_errors(steps: int, samples: int) -> tuple[np.ndarray, ScaledPose]:
    """End positions (samples, 3) of paths whose scale is a random walk that is measured now and then, and their belief.

    The measurement is a Kalman update of the scale.
    """
    rng, walk, noise = np.random.default_rng(0), 0.01**2, 0.03**2
    step = gtsam.Pose3(gtsam.Rot3.Rz(0.1), np.array([1.0, 0.2, 0.0]))
    error, variance = np.zeros(samples), 0.02**2
    error += 0.02 * rng.standard_normal(samples)
    position, turn = np.zeros((samples, 3)), np.eye(3)
    path = ScaledPose.of(GaussianPose.identity())
    for index in range(steps):
        error, variance = error + np.sqrt(walk) * rng.standard_normal(samples), variance + walk
        if index % 5 == 4:
            gain = variance / (variance + noise)
            error = (1 - gain) * error + gain * np.sqrt(noise) * rng.standard_normal(samples)
            variance *= 1 - gain
        position += (1 + error)[:, None] * (turn @ step.translation())
        turn = turn @ step.rotation().matrix()
        motion = GaussianPose(step, np.zeros((6, 6))).with_scale_variance(variance)
        path = path.compose(ScaledPose.of(motion, variance))
    return position, path


def test_a_scale_that_errs_likewise():
    positions, path = path_errors(12, 20000)
    axes = path.total.mean.rotation().matrix()
    believed = axes @ path.total.covariance[3:, 3:] @ axes.T
    true = np.cov(positions.T)
    assert np.trace(true) < np.trace(believed) < 1.3 * np.trace(true)  # an upper bound, and no large one
    assert np.trace(path.pose.covariance[3:, 3:]) < 0.3 * np.trace(true)  # as if independent
    assert np.linalg.eigvalsh(path.total.covariance)[0] > -1e-12


def test_another_estimate_has_room_for_less_of_the_scale():
    motion = GaussianPose(gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 2.0])), 1e-4 * np.eye(6))
    odometry = ScaledPose.of(motion.with_scale_variance(0.04), 0.04)
    same = odometry.replaced(odometry.pose)
    assert same.variance == pytest.approx(0.04) and same.scale_covariance == pytest.approx(odometry.scale_covariance)
    better = odometry.replaced(motion)
    assert better.variance == pytest.approx(1e-4 / 4)
    assert (
        np.linalg.eigvalsh(
            motion.covariance - np.outer(better.scale_covariance, better.scale_covariance) / better.variance
        )[0]
        > -1e-9
    )


def test_a_camera_that_may_have_been_carried():
    pose = GaussianPose(gtsam.Pose3(), some_covariance(0, 0.1))
    carried = pose.after_loss(12.0)
    more = carried.covariance - pose.covariance
    assert carried.mean.equals(pose.mean, 0) and more == pytest.approx(np.diag(np.diag(more)))
    assert 3 * np.sqrt(more[5, 5]) > 12.0 > np.sqrt(more[5, 5])
