"""Sequences in memory and functions that make trajectories, in a study beside recordings and modes."""

from dataclasses import replace

import gtsam
import numpy as np
import pandas as pd
import pytest

import fvslam_graph
from fvslam_graph.core.errors import ConfigError, EstimationError, StudyError
from fvslam_graph.core.frame_result import FrameResult
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.outside import method_results
from fvslam_graph.core.plugins import of_method
from fvslam_graph.core.trajectory import Status, Trajectory
from fvslam_graph.runs.run_folder import read_run
from fvslam_graph.study import run as study_run
from fvslam_graph.study.results import COSTS
from fvslam_graph.study.run import run_study
from fvslam_graph.study.spec import Study
from fvslam_graph.study.statistics import differences
from fvslam_graph.testing import rendered

SIGMA = 0.1  # m and rad


@pytest.fixture(scope="module")
def flown():
    return rendered("uav", frames=12, size="160x120")


@pytest.fixture(autouse=True)
def unplotted(monkeypatch):
    monkeypatch.setattr(study_run, "draw_study", lambda *arguments: [])
    monkeypatch.setattr(study_run, "_draw_trajectories", lambda *arguments: [])


def noisy_truth(sequence, seed):
    """The truth with errors of SIGMA in each motion, which says so."""
    rng, pose = np.random.default_rng(seed), GaussianPose.identity()
    covariance = SIGMA**2 * np.eye(6)
    truth = sequence.ground_truth.poses
    for index, stamp in enumerate(sequence.stamps):
        before = max(index - 1, 0)
        sequence.load(index)
        motion = truth[before].between(truth[index]).retract(SIGMA * rng.standard_normal(6))
        relative = GaussianPose(motion, covariance)
        pose = pose.compose(relative)
        yield FrameResult(index, stamp, pose, Status.TRACKED if index else Status.STATIC, before, relative)


def exact(sequence, seed):
    return sequence.ground_truth


def test_a_function_is_compared_like_a_mode(flown, tmp_path):
    results = fvslam_graph.compare(
        flown, ["vo", noisy_truth], 5, tmp_path, external={"truth": lambda sequence, seed: sequence.ground_truth}
    )
    table = results.table.set_index("mode")
    assert set(table["status"]) == {"finished"} and len(table) == 15
    assert table.loc["noisy_truth", "ape"].nunique() == 5  # each seed is another run
    assert 3 < table.loc["noisy_truth", "nees"].mean() < 10  # 6 is consistent; 55 motions
    assert (table.loc["truth", "ape"] < 1e-9).all() and table.loc["truth", "nees"].isna().all()
    assert (table.loc["noisy_truth", "ms"] > 0).all() and (table["coverage"] == 1).all()
    ratios = {(found.a, found.b): found.ratio for found in differences(results) if found.metric == "ape"}
    assert ratios["vo", "truth"] > 1e6 and ratios["noisy_truth", "truth"] > 1e6


def test_the_same_on_two_workers(flown, tmp_path, caplog):
    """What can be imported is sent, and kept; what cannot runs here, and that is said."""
    options = {"sequences": [flown], "modes": ["vo", exact, lambda sequence, seed: sequence.ground_truth], "seeds": 2}
    tables = [run_study(Study(**options), tmp_path / str(workers), workers).table for workers in (1, 2)]
    names = [column for column in tables[0] if column not in COSTS]
    pd.testing.assert_frame_equal(tables[0][names], tables[1][names])
    assert "<lambda> cannot be imported by its name: it runs in this process" in caplog.text
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "2" / "runs").glob("*/run.json")}
    run_study(Study(**options), tmp_path / "2", 2)
    again = [path.parent.name for path in kept if path.stat().st_mtime_ns != kept[path]]
    assert len(again) == 2 and all("lambda" in name for name in again)


def test_other_images_are_another_sequence(flown, tmp_path):
    """Also where all else is the same."""
    for number, held in enumerate((flown, replace(flown, load=lambda index: flown.load(index) // 2)), 1):
        run_study(Study(sequences=[held], modes=["vo"], seeds=1), tmp_path, 1)
        assert len(list((tmp_path / "runs").glob("*/run.json"))) == number


def test_a_trajectory_of_some_frames(flown, tmp_path):
    def every_second(sequence, seed):
        truth = sequence.ground_truth
        return Trajectory(truth.stamps[::2], truth.poses[::2])

    table = fvslam_graph.compare(flown, [every_second], 1, tmp_path).table
    assert (table["status"][0], table["coverage"][0], table["associated"][0]) == ("finished", 0.5, 6)
    run = read_run(tmp_path / "runs" / table["folder"][0])
    assert run.frames["index"].tolist() == list(range(0, 12, 2))
    assert (run.info["scale_source"], run.info["plugins"][0]["version"]) == ("own", None)


def wrong(make):
    return lambda sequence, seed: make(sequence)


STILL = GaussianPose.identity()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda sequence: None, "an object of NoneType, not a Trajectory or FrameResults"),
        (lambda sequence: [1], "an object of int at frame 0, not a FrameResult"),
        (lambda sequence: [], "has no result for any frame"),
        (lambda sequence: Trajectory(sequence.stamps + 0.01, sequence.ground_truth.poses), "where .* has no frame"),
        (lambda sequence: Trajectory(np.empty(0), ()), "has no pose for any frame"),
        (lambda sequence: [result(1, sequence)], "result of frame 1 at .* at frame 0"),
        (lambda sequence: [result(0, sequence, relative=None)], "an object of NoneType at frame 0, not a GaussianPose"),
        (lambda sequence: [result(0, sequence, status="fine")], "the status 'fine' at frame 0"),
        (
            lambda sequence: [result(0, sequence, pose=GaussianPose(gtsam.Pose3(), np.eye(3)))],
            r"a covariance at frame 0 of shape \(3, 3\)",
        ),
        (
            lambda sequence: [result(index, sequence, measures={f"{index}": 1.0}) for index in range(2)],
            "other measures or times at frame 1",
        ),
        (lambda sequence: [result(index % 12, sequence) for index in range(13)], "more results than .* has frames, 12"),
    ],
)
def test_what_is_no_result(flown, make, said):
    with pytest.raises(EstimationError, match=f"mine .*{said}"):
        list(method_results("mine", wrong(make), flown, 0))


def result(index, sequence, **changes):
    return replace(
        FrameResult(index, float(sequence.stamps[index]), STILL, Status.STATIC, max(index - 1, 0), STILL), **changes
    )


def test_what_is_no_function(flown):
    with pytest.raises(ConfigError, match=r"str cannot be called with \(sequence, seed\); a class is given as a text"):
        fvslam_graph.compare(flown, [str])
    with pytest.raises(ConfigError, match="cannot be called 'vo', which is a mode"):
        fvslam_graph.compare(flown, [], external={"vo": exact})
    with pytest.raises(StudyError, match="listed twice"):
        fvslam_graph.compare(flown, [exact, exact])
    assert of_method("a", exact).origin["source"] and of_method("b", lambda sequence, seed: 0).origin["source"] is None
