"""Prediction, the step into the new camera, and the re-anchoring."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import SlamSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.known_points import KnownPoints
from fvslam_graph.core.vo_estimate import OdometryMotion
from fvslam_graph.slam.initialisation import known_depths, with_new_landmarks
from fvslam_graph.slam.motion import (
    compose,
    last_motion,
    motion_from_velocity,
    predict_constant_velocity,
    predict_from_odometry,
    reanchored,
    with_scale_walk,
)
from fvslam_graph.slam.state import ODOMETRY, POSE, SCALE, VELOCITY

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
    predicted = predict_from_odometry(state, OdometryMotion(motion, np.zeros(6), 1.0, 0.0), SECONDS)
    predicted.check()
    taken = last_motion(predicted, SECONDS)
    assert taken.mean.equals(motion.mean, 1e-9)
    assert taken.covariance == pytest.approx(motion.covariance, rel=1e-6, abs=1e-12)
    assert np.array_equal(predicted.covariance[ODOMETRY:, ODOMETRY:], state.covariance[ODOMETRY:, ODOMETRY:])


def test_odometry_errs_by_one_scale_from_step_to_step(random_state, camera):
    """However doubtful it is, what it says of a step's length against depths is as certain as it says."""
    state, odometry_sigma = random_state(0, sigma=1e-4), 0.5
    state.covariance[ODOMETRY, ODOMETRY] = odometry_sigma**2
    # Depths are added at one step, and the next one goes by 0.5 m, known to 1 %, in the same scale.
    points = KnownPoints(
        np.arange(3), np.array([[100.0, 80.0], [320.5, 240.5], [500.0, 400.0]]), np.full(3, 0.2), np.full(3, 1e-5),
        np.zeros((3, 0)), odometry_sigma**2,
    )  # fmt: skip
    state = with_new_landmarks(state, 100 + points.ids, points.pixels, known_depths(points, camera, state), camera, 0.1)
    pose = GaussianPose(gtsam.Pose3(gtsam.Rot3(), (0.0, 0.0, 0.5)), np.diag([1e-8] * 5 + [0.005**2]))
    alike = predict_from_odometry(state, OdometryMotion(pose, pose.travel, 1.0, 0.0), SECONDS)
    new = predict_from_odometry(state, OdometryMotion(pose, pose.travel, 0.0, odometry_sigma**2), SECONDS)
    for predicted in (alike, new):
        predicted.check()
        assert last_motion(predicted, SECONDS).covariance[5, 5] == pytest.approx((0.5**2 + 0.01**2) * 0.5**2, rel=0.01)
    assert _ratio_sigma(alike) == pytest.approx(0.01, rel=0.05)
    assert _ratio_sigma(new) == pytest.approx(np.hypot(np.sqrt(2) * odometry_sigma, 0.01), rel=0.05)


def _ratio_sigma(state):
    """Deviation of the logarithm of a step over the distance of a landmark."""
    landmark = state.ids.tolist().index(100)
    J_ratio = np.zeros(len(state.covariance))
    J_ratio[VELOCITY.stop - 1] = 1 / state.velocity[5]
    J_ratio[state.parts[1][landmark, 2]] = 1 / state.inverse_depth[landmark, 2]
    return np.sqrt(J_ratio @ state.covariance @ J_ratio)


def test_what_map_and_odometry_say_of_a_step_is_what_odometry_errs(random_state):
    """The longer steps are by the map, the longer odometry is told to be; and is, from then on."""
    state = random_state(1)
    state = replace(state, odometry_scale=np.log(2.0))
    pose = GaussianPose(gtsam.Pose3.Expmap(0.1 * np.arange(6.0)), 1e-4 * np.eye(6))
    taken = last_motion(predict_from_odometry(state, OdometryMotion(pose, pose.travel, 1.0, 0.0), SECONDS), SECONDS)
    assert taken.mean.rotation().equals(pose.mean.rotation(), 1e-9)
    assert taken.mean.translation() == pytest.approx(2 * pose.mean.translation())
    half = predict_from_odometry(state, OdometryMotion(pose, pose.travel, 0.5, 0.0), SECONDS)
    assert half.odometry_scale == pytest.approx(np.log(2.0) / 2)
    assert half.covariance[ODOMETRY, ODOMETRY] == pytest.approx(state.covariance[ODOMETRY, ODOMETRY] / 4)


@pytest.mark.parametrize("seed", SEEDS)
def test_derivative_of_a_motion_of_odometry(random_state, seed):
    """The covariance after a prediction is J P J^T with J by finite differences, plus what the motion errs itself."""
    state, rng = random_state(seed), np.random.default_rng(seed)
    pose = GaussianPose(gtsam.Pose3.Expmap(0.3 * rng.standard_normal(6)), np.zeros((6, 6)))
    odometry, size = OdometryMotion(pose, pose.travel, 0.8, 0.0), len(state.covariance)
    predicted = predict_from_odometry(state, odometry, SECONDS)

    def change(error: np.ndarray) -> np.ndarray:
        moved = predict_from_odometry(state.retract(np.where(np.arange(size) == SCALE, 0.0, error)), odometry, SECONDS)
        result = difference(predicted, moved)
        result[SCALE] = error[SCALE]  # velocity counts in units of the map
        result[VELOCITY] -= error[SCALE] * predicted.velocity * (0, 0, 0, 1, 1, 1)
        return result

    jacobian = numeric(change, size)
    assert agrees(predicted.covariance, jacobian @ state.covariance @ jacobian.T)


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
