"""Which measured motions are believed, and how far."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.vo.plausibility import AGED, INSISTENCE, MotionGate

ACCELERATIONS = np.repeat([0.5, 2.0], 3)  # rad/s^2, m/s^2
SPEED = 10.0  # m/s, forward
STEP = 0.1  # s


def pose(z: float, sigma: float = 0.01, x: float = 0.0) -> GaussianPose:
    return GaussianPose(gtsam.Pose3(gtsam.Rot3(), np.array([x, 0.0, z])), sigma**2 * np.eye(6))


def expected(stamp: float) -> GaussianPose:
    """The pose by constant velocity from a keyframe at 0 s."""
    return GaussianPose(pose(SPEED * stamp).mean, np.diag((0.5 * ACCELERATIONS * stamp**2) ** 2) + 1e-6 * np.eye(6))


def driven() -> MotionGate:
    """A judge that has seen one motion as expected, which made the frame at 0 s the keyframe."""
    plausibility = MotionGate()
    assert plausibility.apply(pose(SPEED * STEP), expected(STEP), 0.0, -STEP, ACCELERATIONS) is not None
    plausibility.forget()
    return plausibility


def judge(plausibility: MotionGate, positions: list[float]) -> list[GaussianPose | None]:
    """What is made of the frames after the keyframe, each STEP later."""
    stamps = STEP * np.arange(1, len(positions) + 1)
    return [
        plausibility.apply(pose(z), expected(stamp), float(stamp), 0.0, ACCELERATIONS)
        for z, stamp in zip(positions, stamps, strict=True)
    ]


def test_what_is_expected_is_believed_as_it_is():
    for verdict, z in zip(judge(driven(), [1.0, 2.02, 2.97]), [1.0, 2.02, 2.97], strict=True):
        assert verdict.covariance == pytest.approx(pose(z).covariance)


def test_images_in_the_wrong_order_are_not_believed():
    verdicts = judge(driven(), [2.0, 1.0, 3.0, 4.0])
    assert [verdict is None for verdict in verdicts] == [True, True, False, False]
    assert verdicts[2].covariance == pytest.approx(pose(3.0).covariance)  # as if nothing had been


@pytest.mark.parametrize("length, believed", [(1.0, True), (2.0, True), (0.5, True), (-1.0, False), (-0.3, False)])
def test_a_doubtful_scale_never_turns_a_motion_round(length, believed):
    """Of which nobody knows how long it is, within a factor of four."""
    measured = pose(length).with_scale_variance(2.0)
    assert (driven().apply(measured, expected(STEP), STEP, 0.0, ACCELERATIONS, 2.0) is not None) == believed
    as_normal = driven().apply(measured, expected(STEP), STEP, 0.0, ACCELERATIONS)
    assert as_normal is not None  # a scale whose own error were normal could do anything


def test_what_does_not_agree_with_itself_is_never_believed():
    assert judge(driven(), [-3.0, 4.0, -2.0, 7.0, -5.0]) == [None] * 5


def test_images_that_insist_are_believed_and_doubted():
    """They say that the camera stands; either may be true, which is within two deviations of both."""
    verdicts = judge(driven(), [0.0] * 12)
    assert [verdict is None for verdict in verdicts[:INSISTENCE]] == [True] * (INSISTENCE - 1) + [False]
    stamp = INSISTENCE * STEP
    believed = verdicts[INSISTENCE - 1]
    assert believed.mean.equals(pose(0.0).mean, 1e-12)
    assert np.sqrt(believed.covariance[5, 5]) == pytest.approx(SPEED * stamp / 2, rel=0.01)


def test_doubt_grows_until_forces_allow_for_either():
    plausibility = driven()
    judge(plausibility, [0.0] * INSISTENCE)
    end = SPEED / ACCELERATIONS[3] / AGED
    sigmas = []
    for stamp in (0.5, end, end + 1):  # standing is what is expected by now
        verdict = plausibility.apply(pose(0.0), pose(0.0), stamp, 0.0, ACCELERATIONS)
        sigmas.append(np.sqrt(verdict.covariance[5, 5]))
    assert sigmas == pytest.approx([SPEED * 0.5 / 2, SPEED * end / 2, SPEED * end / 2], rel=0.01)
    # Against a keyframe within that time, it is what has come since, so that independent motions add up to the whole;
    halves = [
        plausibility.apply(pose(0.0), pose(0.0), stamp, start, ACCELERATIONS).covariance[5, 5]
        for start, stamp in ((0.0, 0.8), (0.8, end))
    ]
    assert np.sqrt(sum(halves)) == pytest.approx(sigmas[-1], rel=0.01)
    # and against a later one, nothing.
    later = plausibility.apply(pose(0.0), pose(0.0), end + 2, end + 1, ACCELERATIONS)
    assert later.covariance == pytest.approx(pose(0.0).covariance)
