"""All errors at once are evo's, pose by pose."""

import gtsam
import numpy as np
import pytest
from evo.core.metrics import PoseRelation, Unit
from evo.main_ape import ape
from evo.main_rpe import rpe

from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation import pose_errors
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.metrics import evaluate

from .conftest import drive

OPTIONS = {
    Alignment.NONE: {},
    Alignment.ORIGIN: {"align_origin": True},
    Alignment.SE3: {"align": True},
    Alignment.SIM3: {"align": True, "correct_scale": True},
}


def noisy(truth: Trajectory) -> Trajectory:
    """Off by a scale, by 1 deg and 2 cm a pose, in a world of its own."""
    rng = np.random.default_rng(0)
    poses = []
    for pose in truth.from_origin().poses:
        error = gtsam.Pose3.Expmap(np.repeat([0.02, 0.02], 3) * rng.standard_normal(6))
        poses.append(gtsam.Pose3(pose.rotation(), 0.8 * pose.translation()) * error)
    return Trajectory(truth.stamps, tuple(poses))


@pytest.mark.parametrize("align", list(Alignment))
def test_every_number_is_evos(align: Alignment) -> None:
    truth = drive(120, step=0.3)
    estimate = noisy(truth)
    ours = evaluate(estimate, truth, align).errors
    assert len(ours) == 6
    for name, found in ours.items():
        relation = PoseRelation.translation_part if name.endswith("trans") else PoseRelation.rotation_angle_deg
        trajectories = truth.to_evo(), estimate.to_evo()
        if name.startswith("ape"):
            theirs = ape(*trajectories, relation, **OPTIONS[align])
        else:
            unit = Unit.meters if "1m" in name else Unit.frames
            theirs = rpe(
                *trajectories, relation, delta=1.0, delta_unit=unit, pairs_from_reference=True, **OPTIONS[align]
            )
        assert found.stats == pytest.approx(theirs.stats, rel=1e-11)
        assert found.info["title"] == theirs.info["title"] and found.info["label"] == theirs.info["label"]
        assert set(found.np_arrays) == set(theirs.np_arrays)
        for key, array in theirs.np_arrays.items():
            assert found.np_arrays[key] == pytest.approx(array, rel=1e-11, abs=1e-11), key
        for key, trajectory in theirs.trajectories.items():
            assert np.allclose(found.trajectories[key].poses_se3, trajectory.poses_se3, atol=1e-9)


def test_blocks_leave_nothing_out(monkeypatch) -> None:
    truth = drive(250)
    estimate = noisy(truth)
    whole = evaluate(estimate, truth)
    monkeypatch.setattr(pose_errors, "BLOCK", 7)
    parts = evaluate(estimate, truth)
    assert {name: error.stats for name, error in parts.errors.items()} == {
        name: error.stats for name, error in whole.errors.items()
    }
    assert parts.drift == whole.drift and whole.drift.segments > 7


def test_what_goes_on_is_logged(caplog) -> None:
    with caplog.at_level("INFO", "fvslam_graph.evaluation"):
        evaluate(drive(20), drive(20))
    assert [message.split()[0] for message in caplog.messages] == ["pairing", "aligning", "comparing"]
