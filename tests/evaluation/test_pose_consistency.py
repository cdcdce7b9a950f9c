import gtsam
import numpy as np
import pytest

from fvslam_graph.evaluation.association import associate
from fvslam_graph.evaluation.plots.frames import baselines
from fvslam_graph.evaluation.pose_consistency import pose_consistency
from fvslam_graph.runs.run_folder import read_run

from .conftest import MakeRun, drive


def test_poses_of_a_consistent_estimator_are_consistent(make_run: MakeRun) -> None:
    """Steps err as they say: over 40 runs, the NEES of the last pose is chi-square with six degrees of freedom."""
    values, inside = [], []
    for seed in range(40):
        run = read_run(make_run(f"run{seed}", drive(12), seed))
        assert run.ground_truth is not None
        errors = pose_consistency(associate(run.online, run.ground_truth), run.pose_covariances)
        assert errors is not None and errors.frames.tolist() == list(range(1, 12)) and set(errors.dof) == {6}
        values.append(errors.nees[-1])
        sigmas = np.sqrt(np.diagonal(errors.covariances, axis1=1, axis2=2))
        inside.append(np.abs(errors.positions) <= 3 * sigmas)
    assert 6 - 4 * np.sqrt(12 / 40) < np.mean(values) < 6 + 4 * np.sqrt(12 / 40)
    assert np.mean(inside) > 0.98


def test_axes_and_scale(make_run: MakeRun) -> None:
    """Half the scale: corrected, both the error and its covariance are those of the whole."""
    truth = drive(12)
    run = read_run(make_run("half", truth, gain=0.5))
    assert run.pose_covariances is not None
    pairs = associate(run.online, truth)
    errors = pose_consistency(pairs, run.pose_covariances)
    assert errors is not None
    expected = gtsam.Pose3.between(truth.poses[0], truth.poses[5]).translation()
    assert errors.positions[4] == pytest.approx(-0.5 * expected, abs=0.1)
    doubled = pose_consistency(pairs, run.pose_covariances, 2.0)
    assert doubled is not None
    assert np.allclose(doubled.covariances, 4 * errors.covariances)
    assert np.abs(doubled.positions).max() < 0.3


def test_without_covariances_there_are_none(make_run: MakeRun) -> None:
    truth = drive(12)
    run = read_run(make_run("run", truth))
    assert pose_consistency(associate(run.online, truth), None) is None
    assert pose_consistency(associate(run.online, truth), np.zeros((12, 6, 6))) is None


def test_baselines_are_those_of_the_keyframes(make_run: MakeRun) -> None:
    """A scale that is right lies on the truth, whichever frame its baseline began at."""
    truth = drive(12, step=2.0)
    run = read_run(make_run("run", truth))
    found = baselines(associate(run.online, truth), np.array([0, 2, -1, 7]), np.array([1, 5, 6, 7]))
    assert found[:2] == pytest.approx([2, 6], rel=1e-3)
    assert np.isnan(found[2:]).all()
