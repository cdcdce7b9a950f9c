"""Motions that a vehicle cannot make."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.estimates import GaussianPose
from fvslam_graph.fusion.plausibility import PATIENCE, Plausibility

FORWARD = gtsam.Pose3(gtsam.Rot3.Yaw(0.01), np.array([0.0, 0.0, 1.0]))
JUMP = gtsam.Pose3(gtsam.Rot3(), np.array([0.8, 0.0, 1.0]))


def sure(pose: gtsam.Pose3) -> GaussianPose:
    return GaussianPose(pose, np.diag(np.repeat([1e-4, 1e-2], 3) ** 2))


def test_steady_motion_passes():
    check = Plausibility()
    for _ in range(5):
        motion = sure(FORWARD)
        assert check.checked(motion, 0.1) is motion


def test_a_jump_is_replaced_by_what_was_expected():
    check = Plausibility()
    for _ in range(3):
        check.checked(sure(FORWARD), 0.1)
    replaced = check.checked(sure(JUMP), 0.1)
    assert replaced.mean.equals(FORWARD, 1e-9)
    assert np.sqrt(replaced.covariance[3, 3]) == 3.0 * 0.1**2
    motion = sure(FORWARD)
    assert check.checked(motion, 0.1) is motion


def test_an_old_velocity_says_less():
    """The acceleration may have lasted since then."""
    check = Plausibility()
    for _ in range(3):
        check.checked(sure(FORWARD), 0.1)
    spread = [np.sqrt(check.checked(sure(JUMP), 0.1).covariance[3, 3]) for _ in range(3)]
    assert spread == pytest.approx([0.03, 0.06, 0.09])


def test_a_velocity_over_a_gap_says_less():
    """The mean over ten seconds in which a car stopped and started again is not how fast it is now."""
    check = Plausibility()
    for seconds in (0.1, 0.1, 0.1, 10.0):
        check.checked(sure(FORWARD), seconds)
    motion = sure(FORWARD)
    assert check.checked(motion, 0.1) is motion


def test_a_jump_that_stays_is_a_new_velocity():
    check = Plausibility()
    for _ in range(3):
        check.checked(sure(FORWARD), 0.1)
    passed = [check.checked(sure(JUMP), 0.1).mean.equals(JUMP, 1e-9) for _ in range(PATIENCE + 2)]
    assert passed == [False] * PATIENCE + [True, True]


def test_nothing_is_expected_after_a_single_motion():
    check = Plausibility()
    check.checked(sure(JUMP), 0.1)
    motion = sure(FORWARD)
    assert check.checked(motion, 0.1) is motion


def test_an_uncertain_motion_is_plausible():
    check = Plausibility()
    for _ in range(3):
        check.checked(sure(FORWARD), 0.1)
    motion = GaussianPose(JUMP, np.eye(6))
    assert check.checked(motion, 0.1) is motion
