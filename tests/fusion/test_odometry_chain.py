"""The motion since an anchor, from motions against frames before."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.gaussian_pose import GaussianPose, LogScale
from fvslam_graph.core.vo_estimate import OdometryStep, ScaleStep
from fvslam_graph.evaluation.nees import nees
from fvslam_graph.fusion.odometry_chain import OdometryChain


def step(seed: int) -> GaussianPose:
    rng = np.random.default_rng(seed)
    mixing = 0.01 * rng.standard_normal((6, 6))
    return GaussianPose(gtsam.Pose3.Expmap(0.3 * rng.standard_normal(6)), mixing @ mixing.T)


def test_frame_to_frame():
    chain, expected = OdometryChain(), GaussianPose.identity()
    chain.add(0, OdometryStep(0, GaussianPose.identity()))
    for index in range(1, 6):
        chain.add(index, OdometryStep(index - 1, step(index)))
        expected = expected.compose(step(index))
    assert chain.motion.pose.mean.equals(expected.mean, 1e-12)
    assert chain.motion.pose.covariance == pytest.approx(expected.covariance)


def test_several_frames_against_one():
    chain = OdometryChain()
    chain.add(0, OdometryStep(0, GaussianPose.identity()))
    for index in (1, 2, 3):
        chain.add(index, OdometryStep(0, step(index)))
        assert chain.motion.pose.mean.equals(step(index).mean, 1e-12)
    chain.add(4, OdometryStep(3, step(4)))
    assert chain.motion.pose.mean.equals(step(3).compose(step(4)).mean, 1e-12)


def test_an_anchor_between_reference_and_frame():
    """Frames 1 and 2 were measured against frame 0; the anchor is frame 1."""
    chain = OdometryChain()
    chain.add(0, OdometryStep(0, GaussianPose.identity()))
    chain.add(1, OdometryStep(0, step(1)))
    chain.anchor()
    assert chain.motion.pose.mean.equals(gtsam.Pose3(), 0) and not chain.motion.pose.covariance.any()
    chain.add(2, OdometryStep(0, step(2)))
    assert chain.motion.pose.mean.equals(step(1).mean.between(step(2).mean), 1e-12)
    assert chain.motion.pose.covariance == pytest.approx(step(2).covariance)
    chain.add(3, OdometryStep(2, step(3)))
    assert chain.motion.pose.mean.equals(step(1).mean.between(step(2).mean).compose(step(3).mean), 1e-12)


@pytest.mark.parametrize("goes_on", [False, True])
def test_two_motions_against_one_frame(goes_on):
    """By a tracker that looks for the points of the first frame, or that goes on from where it found them."""
    rng, errors, covariances = np.random.default_rng(0), [], []
    for _ in range(400):
        noise = 0.01 * rng.standard_normal((3, 6))
        first = noise[0] + noise[1]
        both = (first, first + noise[2]) if goes_on else (first, noise[0] + noise[2])
        chain = OdometryChain()
        chain.add(0, OdometryStep(0, GaussianPose.identity()))
        variances = 2e-4, 3e-4 if goes_on else 2e-4
        for index, (error, variance) in enumerate(zip(both, variances, strict=True), 1):
            chain.add(index, OdometryStep(0, GaussianPose(gtsam.Pose3.Expmap(error), variance * np.eye(6))))
            if index == 1:
                chain.anchor()
        errors.append(gtsam.Pose3.Logmap(chain.motion.pose.mean))
        covariances.append(chain.motion.pose.covariance)
    mean = nees(np.array(errors), np.array(covariances))[0].mean()
    assert (1.8 < mean < 2.2) if goes_on else (5.6 < mean < 6.4)  # a third of the variance; all of it


def test_an_anchor_that_is_the_reference():
    chain = OdometryChain()
    chain.add(0, OdometryStep(0, GaussianPose.identity()))
    chain.add(1, OdometryStep(0, step(1)))
    chain.anchor()
    chain.add(2, OdometryStep(1, step(2)))
    assert chain.motion.pose.mean.equals(step(2).mean, 1e-12)
    assert chain.motion.pose.covariance == pytest.approx(step(2).covariance)


def test_nothing_usable_at_first():
    chain = OdometryChain()
    for index in range(3):
        chain.add(index, OdometryStep(0, step(index)))  # coasting from a start that no image has shown
    chain.add(3, OdometryStep(3, step(3)))
    assert chain.motion.pose.mean.equals(step(3).mean, 1e-12)


@pytest.mark.parametrize("anchored", [False, True])
def test_a_motion_from_a_frame_that_was_lost(anchored):
    """Frame 1 is lost, frame 2 not where it is thought to be, and frame 4 is measured against frame 1 again."""
    chain = OdometryChain()
    chain.add(0, OdometryStep(0, GaussianPose.identity()))
    chain.add(1, OdometryStep(0, step(1)))
    vague = GaussianPose(step(2).mean, 100 * np.eye(6))
    chain.add(2, OdometryStep(1, vague, awaited=(1,), measured=False))
    if anchored:
        chain.anchor()
    chain.add(3, OdometryStep(2, step(3), awaited=(1,)))
    chain.add(4, OdometryStep(1, step(4)))
    expected = step(1).mean.compose(step(4).mean)
    if anchored:
        expected = step(1).mean.compose(vague.mean).between(expected)
    assert chain.motion.total.mean.equals(expected, 1e-9)
    # What was vague does not matter any more, unless the anchor is where it ended.
    assert bool(np.trace(chain.motion.total.covariance) > 100) == anchored


def scaled_step(previous: int, filtered: float, added: float, room: float | None = None) -> OdometryStep:
    """A metre ahead in a scale whose log variance was `filtered` after `added` was added to it."""
    pose = GaussianPose(gtsam.Pose3(gtsam.Rot3(), (0.0, 0.0, 1.0)), 1e-6 * np.eye(6))
    scale = ScaleStep(LogScale(0.0, filtered), LogScale(0.0, added), LogScale(0.0, 1.0))
    held = filtered if room is None else room
    return OdometryStep(previous, pose.with_scale_variance(held), scale, filtered)


def test_the_error_of_the_scale_is_a_chain():
    """That of a Kalman filter: its covariance after some steps with that before, by simulation of its gains."""
    chain, variance = OdometryChain(), 0.0
    chain.add(0, OdometryStep(0, GaussianPose.identity()))
    rng, errors = np.random.default_rng(0), np.zeros(200_000)
    for index in range(1, 9):
        added, noise = 0.02**2, 0.05**2 if index > 2 else np.inf  # the source begins to speak
        gain = (variance + added) / (variance + added + noise)
        variance = (1 - gain) * (variance + added)
        errors = (1 - gain) * (errors + np.sqrt(added) * rng.standard_normal(len(errors)))
        if gain > 0:
            errors = errors + gain * np.sqrt(noise) * rng.standard_normal(len(errors))
        chain.add(index, scaled_step(index - 1, variance, added))
        if index == 3:
            chain.anchor()
            before = errors
    motion = chain.motion_in_scale
    assert motion.scale_kept == pytest.approx(np.mean(before * errors) / np.mean(before**2), abs=0.02)
    assert motion.scale_added == pytest.approx(np.mean((errors - motion.scale_kept * before) ** 2), rel=0.02)


def test_a_motion_and_what_its_scale_errs_are_all_that_it_errs():
    chain = OdometryChain()
    chain.add(0, OdometryStep(0, GaussianPose.identity()))
    for index in range(1, 4):
        chain.add(index, scaled_step(index - 1, 0.1**2, 0.0))
    motion = chain.motion_in_scale
    assert motion.J_scale == pytest.approx([0, 0, 0, 0, 0, 3.0])
    assert motion.pose.covariance[5, 5] == pytest.approx(3e-6)
    total = motion.pose.covariance + 0.1**2 * np.outer(motion.J_scale, motion.J_scale)
    assert total == pytest.approx(chain.motion.total.covariance)
    chain.anchor()
    chain.add(4, scaled_step(3, 1.0, 0.0, room=0.01))  # hardly a length: however doubtful the scale, it errs by 10 %
    motion = chain.motion_in_scale
    assert motion.J_scale == pytest.approx([0, 0, 0, 0, 0, 0.01], rel=1e-3)
    assert motion.pose.covariance[5, 5] == pytest.approx(0.01 - 0.01**2, rel=1e-3)


def test_an_anchor_that_something_else_knows_better():
    chain = OdometryChain()
    chain.add(0, OdometryStep(0, GaussianPose.identity()))
    chain.add(1, OdometryStep(0, step(1), awaited=(0,)))
    chain.add(2, OdometryStep(1, step(2), awaited=(0,)))
    chain.anchor(step(5))
    chain.add(3, OdometryStep(0, step(3)))
    assert chain.motion.total.mean.equals(step(5).mean.between(step(3).mean), 1e-9)
