"""Factors of a fix, against the nonlinear relation and numerical derivatives."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import GraphSettings
from fvslam_graph.graph.factors import CLOCK, ENU, fix_key, pose_key
from fvslam_graph.graph.fix_factors import (
    ADDED,
    ROTATION_SIGMA,
    GraphFix,
    KnownPath,
    clock_prior,
    moment_factor,
    place_factor,
)

POSE = gtsam.Pose3(gtsam.Rot3.Ypr(0.3, -0.2, 0.1), np.array([3.0, 4.0, 5.0]))
MOTION = gtsam.Pose3.Expmap(np.array([0.02, 0.05, -0.01, 0.1, 0.2, 1.0]))
PATH = KnownPath([10.0, 10.1], [POSE.compose(MOTION.inverse()), POSE].__getitem__)
KEY, FRAME = fix_key(0), pose_key(1)
SIGMA, OFFSET = 1.5, 0.02


@pytest.fixture
def moment():
    return PATH.at(10.03 + OFFSET)


def values_at(pose: gtsam.Pose3, at_fix: gtsam.Pose3, offset: float) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(FRAME, pose)
    values.insert(KEY, at_fix)
    values.insert(CLOCK, offset)
    return values


def test_between_two_frames_the_camera_moves_evenly(moment):
    assert moment.frame == 1
    half = PATH.at(10.05).frame_T_camera
    assert half.inverse().equals(gtsam.Pose3.Expmap(gtsam.Pose3.Logmap(MOTION) / 2), 1e-12)
    assert PATH.at(10.0).frame_T_camera.inverse().equals(MOTION, 1e-12)
    assert PATH.at(10.1).frame_T_camera.equals(gtsam.Pose3(), 1e-12)
    assert np.allclose(moment.twist, gtsam.Pose3.Logmap(MOTION) / 0.1)


def test_far_from_all_frames_nothing_is_known():
    assert PATH.at(10.19) is not None and PATH.at(9.91) is not None
    assert PATH.at(10.21) is None and PATH.at(9.89) is None
    assert KnownPath([10.0], [POSE].__getitem__).at(10.0) is None


def test_derivatives_are_those_of_the_relation(moment):
    factor = moment_factor(KEY, moment, OFFSET, POSE, SIGMA)
    there = POSE.compose(moment.frame_T_camera)
    root = 1 / np.repeat([ROTATION_SIGMA, np.sqrt(ADDED) * SIGMA], 3)

    def error(step):
        pose, at_fix, offset = POSE.retract(step[:6]), there.retract(step[6:12]), OFFSET + step[12]
        expected = pose.compose(moment.frame_T_camera).compose(gtsam.Pose3.Expmap(moment.twist * step[12]))
        assert factor.error(values_at(pose, at_fix, offset)) == pytest.approx(
            ((root * gtsam.Pose3.Logmap(expected.between(at_fix))) ** 2).sum() / 2, rel=1e-3
        )
        return root * gtsam.Pose3.Logmap(expected.between(at_fix))

    linear = factor.linearize(values_at(POSE, there, OFFSET))
    order = gtsam.Ordering()
    for key in (FRAME, KEY, CLOCK):
        order.push_back(key)
    graph = gtsam.GaussianFactorGraph()
    graph.push_back(linear)
    jacobian, right = graph.jacobian(order)
    assert np.abs(right).max() < 1e-9
    for column, direction in enumerate(np.eye(13)):
        difference = (error(1e-6 * direction) - error(-1e-6 * direction)) / 2e-6
        assert jacobian[:, column] == pytest.approx(difference, rel=1e-5, abs=1e-3)


def test_a_path_that_is_moved_as_a_whole_costs_nothing(moment):
    factor = moment_factor(KEY, moment, OFFSET, POSE, SIGMA)
    away = gtsam.Pose3(gtsam.Rot3.Ypr(0.5, 0.2, -0.3), np.array([10.0, -5.0, 2.0]))
    moved = away.compose(POSE)
    assert factor.error(values_at(moved, moved.compose(moment.frame_T_camera), OFFSET)) < 1e-12


@pytest.mark.parametrize("away", [0.0, 0.4])
def test_the_place_is_measured_with_its_deviations(away):
    world_T_enu = gtsam.Pose3(gtsam.Rot3.Ypr(1.0, 0.1, 0.2), np.array([1.0, -2.0, 0.5]))
    there = world_T_enu.transformTo(POSE.translation())
    fix = GraphFix(10.0, there + away * np.array([0.0, 1.0, 0.0]), np.array([0.5, 0.2, 0.5]))
    values = gtsam.Values()
    values.insert(ENU, world_T_enu)
    values.insert(KEY, POSE)
    enu_R_camera = world_T_enu.rotation().between(POSE.rotation())
    factor = place_factor(KEY, fix, enu_R_camera, GraphSettings(kernel="none"))
    assert factor.error(values) == pytest.approx((away / 0.2) ** 2 / 2, abs=1e-9)


def test_a_clock_far_off_costs_less_than_by_a_normal_distribution():
    prior, values = clock_prior(GraphSettings(clock_sigma=0.1)), gtsam.Values()
    values.insert(CLOCK, 1.0)
    assert prior.error(values) == pytest.approx(np.log1p(100) / 2)
