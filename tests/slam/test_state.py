"""The error state, its covariance, and the scale that is kept apart."""

from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.slam.motion import last_motion
from fvslam_graph.slam.state import FIXED, SCALE, VELOCITY

from .conftest import agrees, difference, numeric


def test_moved_is_undone_by_difference(random_state):
    state = random_state(0)
    error = 0.1 * np.random.default_rng(1).standard_normal(len(state.covariance))
    error[SCALE] = 0.0
    assert difference(state, state.retract(error)) == pytest.approx(error)


def test_the_scale_makes_all_lengths_longer(random_state):
    state = random_state(1)
    error = np.zeros(len(state.covariance))
    error[SCALE] = np.log(2.0)
    doubled = state.retract(error)
    assert doubled.positions == pytest.approx(2 * state.positions)
    assert doubled.velocity == pytest.approx(state.velocity * (1, 1, 1, 2, 2, 2))
    assert doubled.world_T_camera.equals(state.world_T_camera, 0)
    growth = numeric(lambda e: difference(state, state.retract(e[0] * np.eye(len(error))[SCALE])), 1)[:, 0]
    assert agrees(state.J_scale, growth)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_kept_stays_as_it_is(random_state, seed):
    state = random_state(seed)
    kept = np.random.default_rng(seed).random(len(state)) > 0.4
    left = state.without(~kept, np.zeros(6, bool))
    left.check()
    assert left.ids.tolist() == state.ids[kept].tolist()
    assert left.positions == pytest.approx(state.positions[kept])
    assert left.position_covariances() == pytest.approx(state.position_covariances()[kept])
    assert state.without(np.zeros(len(state), bool), np.zeros(6, bool)) is state


@pytest.mark.parametrize("seed", range(5))
def test_points_are_what_the_landmarks_were(random_state, seed):
    state = random_state(seed)
    linear = np.array([True, False, True, True, False, False])
    kept = np.arange(10) != 2
    turned = state.without(~kept, linear)
    turned.check()
    assert len(turned.anchored_inverse_depth) == 3 and len(turned.points) == 6
    assert set(turned.ids) == set(state.ids[kept])
    order = [state.ids.tolist().index(identity) for identity in turned.ids]
    assert turned.positions == pytest.approx(state.positions[order])
    assert turned.position_covariances() == pytest.approx(state.position_covariances()[order])
    assert turned.covariance[:FIXED, :FIXED] == pytest.approx(state.covariance[:FIXED, :FIXED])


@pytest.mark.parametrize("seed", range(5))
def test_the_scale_apart_changes_nothing_metric(random_state, seed):
    state = random_state(seed)
    apart = state.with_scale_decoupled()
    apart.check()
    assert np.array_equal(apart.positions, state.positions)
    assert apart.position_covariances() == pytest.approx(state.position_covariances(), rel=1e-6, abs=1e-9)
    motion, same = last_motion(state, 0.1), last_motion(apart, 0.1)
    assert same.covariance == pytest.approx(motion.covariance, rel=1e-6, abs=1e-12)
    assert apart.covariance[:6, :6] == pytest.approx(state.covariance[:6, :6])


def test_a_common_error_of_all_distances_becomes_one_of_the_scale(random_state):
    state = random_state(2)
    common = np.outer(state.J_scale, state.J_scale)  # all lengths are wrong alike, by a factor of deviation e^0.1
    apart = replace(state, covariance=0.1**2 * common).with_scale_decoupled()
    assert apart.covariance[SCALE, SCALE] == pytest.approx(0.1**2)
    apart_from_it = np.delete(np.delete(apart.covariance, SCALE, 0), SCALE, 1)
    assert np.abs(apart_from_it).max() < 1e-12


def test_an_anchor_lasts_as_long_as_a_landmark_has_it(random_state):
    state, rows = random_state(0), np.arange(10)
    assert len(state.anchors) == 4 and state.anchor_of.tolist() == [0, 1, 1, 2, 2, 3]
    for left in (state.without(rows == 0, rows[:6] < 0), state.without(rows < 0, rows[:6] == 0)):
        assert np.array_equal(left.anchors, state.anchors[1:])
        assert left.anchor_of.tolist() == [0, 0, 1, 1, 2]
    for left in (state.without(rows == 1, rows[:6] < 0), state.without(rows < 0, rows[:6] == 1)):
        assert np.array_equal(left.anchors, state.anchors)
        assert left.anchor_of.tolist() == [0, 1, 2, 2, 3]


def test_check_tells_what_is_wrong(random_state):
    state = random_state(0)
    state.check()
    for spoil, complaint in (
        (lambda c: c.__setitem__((0, 1), c[0, 1] + 1e-9), "not symmetric"),
        (lambda c: c.__setitem__((VELOCITY.start, VELOCITY.start), -1.0), "has the eigenvalue"),
        (lambda c: c.__setitem__((0, 0), np.nan), "not finite"),
    ):
        covariance = state.covariance.copy()
        spoil(covariance)
        with pytest.raises(AssertionError, match=complaint):
            replace(state, covariance=covariance).check()
