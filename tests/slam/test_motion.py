"""Prediction, the step into the new camera, and the re-anchoring."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import SlamSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.slam.motion import (
    compose,
    last_motion,
    motion_from_velocity,
    predict_constant_velocity,
    predict_from_odometry,
    reanchored,
    with_scale_walk,
)
from fvslam_graph.slam.state import POSE, SCALE, VELOCITY

from .conftest import agrees, difference, numeric, random_covariance

SEEDS = range(10)
SECONDS = 0.1


@pytest.mark.parametrize("seed", SEEDS)
def test_derivative_of_the_way_travelled(seed):
    velocity = np.random.default_rng(seed).standard_normal(6)
    pose, J_velocity = motion_from_velocity(velocity, SECONDS)
    assert agrees(
        J_velocity, numeric(lambda e: pose.localCoordinates(motion_from_velocity(velocity + e, SECONDS)[0]), 6)
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_derivative_of_a_step(random_state, seed):
    """The covariance after a step is J P J^T with J by finite differences; the scale is a row of its own."""
    state = random_state(seed)
    after, size = compose(state, SECONDS), len(state.covariance)

    def change(error: np.ndarray) -> np.ndarray:
        # What a different scale does is seen in the pose; map and velocity count in units of the map.
        moved = state.retract(np.where(np.arange(size) == SCALE, 0.0, error))
        prev_T_cur, _ = motion_from_velocity(moved.velocity, SECONDS)
        longer = gtsam.Pose3(prev_T_cur.rotation(), np.exp(error[SCALE]) * prev_T_cur.translation())
        result = difference(after, compose(moved, SECONDS))
        result[POSE] = after.world_T_camera.localCoordinates(moved.world_T_camera.compose(longer))
        result[SCALE] = error[SCALE]
        return result

    jacobian = numeric(change, size)
    assert agrees(after.covariance, jacobian @ state.covariance @ jacobian.T)
    after.check()


def test_a_step_moves_the_map_as_gtsam_does(random_state):
    state = random_state(0)
    prev_T_cur, _ = motion_from_velocity(state.velocity, SECONDS)
    after = compose(state, SECONDS)
    assert after.positions == pytest.approx(prev_T_cur.transformTo(state.positions.T).T)
    assert after.world_T_camera.equals(state.world_T_camera.compose(prev_T_cur), 1e-12)


def test_noise_does_not_depend_on_the_frame_rate(random_state):
    state, settings = random_state(1), SlamSettings()
    once = predict_constant_velocity(state, 0.2, settings)
    twice = predict_constant_velocity(predict_constant_velocity(state, 0.1, settings), 0.1, settings)
    assert twice.covariance == pytest.approx(once.covariance)
    added = np.diag(once.covariance - state.covariance)[VELOCITY]
    assert added == pytest.approx(0.2 * np.repeat([settings.angular_noise**2, settings.linear_noise**2], 3))


@pytest.mark.parametrize("seed", SEEDS)
def test_odometry_is_taken_as_it_is(random_state, seed):
    """Whatever is uncertain of the map's scale, the metric motion is that of the odometry."""
    state, rng = random_state(seed), np.random.default_rng(seed)
    motion = GaussianPose(gtsam.Pose3.Expmap(0.3 * rng.standard_normal(6)), random_covariance(rng, 6, 0.02))
    predicted = predict_from_odometry(state, motion, SECONDS)
    predicted.check()
    taken = last_motion(predicted, SECONDS)
    assert taken.mean.equals(motion.mean, 1e-9)
    assert taken.covariance == pytest.approx(motion.covariance, rel=1e-6, abs=1e-12)
    assert np.array_equal(predicted.covariance[13:, 13:], state.covariance[13:, 13:])


def test_reanchoring_leaves_the_map_as_it_is(random_state):
    """Landmarks in the camera and their covariances are the same to the bit (issue: camera-centred map)."""
    state, rng = random_state(3), np.random.default_rng(3)
    pose = GaussianPose(gtsam.Pose3.Expmap(rng.standard_normal(6)), random_covariance(rng, 6, 0.1))
    anchored = reanchored(state, pose)
    anchored.check()
    assert np.array_equal(anchored.positions, state.positions)
    assert np.array_equal(anchored.covariance[6:, 6:], state.covariance[6:, 6:])
    assert np.array_equal(anchored.covariance[POSE, POSE], pose.covariance)
    assert np.all(anchored.covariance[POSE, 6:] == 0)
    assert anchored.world_T_camera.equals(pose.mean, 0)


def test_a_map_that_is_renewed_drifts_in_scale(random_state):
    """No image is predicted anywhere else by it, and the way travelled is less certain."""
    state = random_state(0)
    half, whole = (with_scale_walk(state, renewed) for renewed in (0.5, 1.0))
    added = whole.covariance - state.covariance
    assert added[SCALE, SCALE] > 0 and np.count_nonzero(added) == 1
    assert (half.covariance - state.covariance)[SCALE, SCALE] == pytest.approx(added[SCALE, SCALE] / 2)
    before, after = (last_motion(compose(each, SECONDS), SECONDS) for each in (state, whole))
    assert np.trace(after.covariance) > np.trace(before.covariance)
