"""What users get for their own tests."""

import subprocess
import sys
from dataclasses import replace

import pytest

import fvslam_graph
from fvslam_graph.core.errors import EstimationError
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.fusion.rules import Average
from fvslam_graph.testing import assert_ape_below, assert_rule_is_consistent


def test_the_worlds(uav_sequence, drive_sequence):
    for sequence, length in ((uav_sequence, 49), (drive_sequence, 40)):
        assert len(sequence) == len(sequence.ground_truth) == 40
        assert sequence.ground_truth.path_length == pytest.approx(length, abs=3)
        assert all(frame.image.shape == (sequence.camera.height, sequence.camera.width) for frame in sequence)


def test_an_estimate_that_is_good_enough(uav_sequence):
    run = fvslam_graph.run(uav_sequence)
    evaluation = assert_ape_below(run, 0.1)
    error = evaluation.errors["ape_trans"].stats["rmse"]
    assert 0.001 < error < 0.1
    assert_ape_below(run.online, 1.01 * error, uav_sequence.ground_truth)


def test_an_estimate_that_is_not(uav_sequence):
    truth = uav_sequence.ground_truth
    still = Trajectory(truth.stamps, (truth.poses[0],) * len(truth))
    with pytest.raises(AssertionError, match=r"APE 28\.\d+ m \(RMSE, se3 alignment\) is not below 1 m"):
        assert_ape_below(still, 1, truth)
    half = Trajectory(truth.stamps[:20], truth.poses[:20])
    with pytest.raises(AssertionError, match="20 of 40 frames have a pose, fewer than 100 %"):
        assert_ape_below(half, 1, truth)
    assert_ape_below(half, 1e-6, truth, coverage=0.5)


def scaled(factor):
    def rule(odometry, slam):
        fused = Average(0.5)(odometry, slam)
        return replace(fused, covariance=factor * fused.covariance)

    return rule


def test_a_rule_is_as_wrong_as_it_says():
    assert 3.5 < assert_rule_is_consistent(scaled(1), seeds=6).mean < 8  # measured 5.2 over 40 runs


@pytest.mark.parametrize(("factor", "said"), [(0.25, "overconfident"), (4, "needlessly cautious")])
def test_a_rule_that_is_not(factor, said):
    """Over 40 runs, the mean NEES is 20.8 and 1.3."""
    with pytest.raises(AssertionError, match=f"the rule is {said}: mean NEES .* of 24 motions is not between"):
        assert_rule_is_consistent(scaled(factor), seeds=6)


def test_a_rule_that_is_none():
    with pytest.raises(EstimationError, match="the rule returns an object of NoneType of two motions"):
        assert_rule_is_consistent(lambda odometry, slam: None, seeds=1)


def test_without_pytest():
    """The functions are there all the same."""
    script = "import sys; sys.modules['pytest'] = None; from fvslam_graph.testing import assert_ape_below, rendered"
    subprocess.run([sys.executable, "-c", script], check=True)
