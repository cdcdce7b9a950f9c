import json
import os
import subprocess
import sys
from pathlib import Path

import gtsam
import numpy as np
import pytest
from evo.tools.file_interface import load_res_file

from fvslam_graph.core.errors import ResultsError, TrajectoryError
from fvslam_graph.core.trajectory import Status, Trajectory
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.metrics import evaluate
from fvslam_graph.evaluation.runs import evaluate_run, evaluation_of
from fvslam_graph.runs.run_folder import read_run

from .conftest import WORLD_T_START, MakeRun, drive

ERRORS = ("ape_trans", "ape_rot", "rpe_trans", "rpe_rot", "rpe_1m_trans", "rpe_1m_rot")


def evo(tmp_path: Path, *arguments: str | Path) -> str:
    """Run one of evo's commands without a display and without the user's settings."""
    command = [Path(sys.executable).parent / arguments[0], *arguments[1:], "--no_warnings"]
    environment = {**os.environ, "MPLBACKEND": "Agg", "HOME": str(tmp_path)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


def shifted(trajectory: Trajectory, seconds: float) -> Trajectory:
    return Trajectory(trajectory.stamps + seconds, trajectory.poses)


@pytest.mark.parametrize("offset", [0.0, 0.004])
def test_evo_ape_finds_the_same_numbers(tmp_path: Path, make_run: MakeRun, offset: float) -> None:
    folder = make_run(gain=0.9)
    shifted(drive(251), -offset).write_tum(tmp_path / "reference.txt")
    evaluate_run(folder, tmp_path / "reference.txt", Alignment.SIM3)
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["association"] == ("reference interpolated" if offset else "nearest stamps")

    files = ("tum", folder / "reference.tum", folder / "trajectory_online.tum", "-as")
    evo(tmp_path, "evo_ape", *files, "--save_results", tmp_path / "ape.zip")
    theirs = load_res_file(tmp_path / "ape.zip").stats
    assert 0.05 < theirs["rmse"] < 1
    assert metrics["ape_trans"] == pytest.approx(theirs, rel=1e-9)
    assert metrics["ape_scaled"] == pytest.approx(theirs["rmse"], rel=1e-9)
    evaluation = evaluate_run(folder, tmp_path / "reference.txt", Alignment.SE3)
    assert evaluation.ape_scaled == pytest.approx(theirs["rmse"], rel=1e-9)
    assert evaluation.errors["ape_trans"].stats["rmse"] > 2 * theirs["rmse"]
    if not offset:  # then the file of the reference itself is as good
        evo(tmp_path, "evo_ape", "tum", tmp_path / "reference.txt", *files[2:], "--save_results", tmp_path / "same.zip")
        assert load_res_file(tmp_path / "same.zip").stats == pytest.approx(theirs, rel=1e-9)


def test_evo_rpe_finds_the_same_numbers_and_evo_res_opens_the_zips(tmp_path: Path, make_run: MakeRun) -> None:
    folders = [make_run("first"), make_run("second", seed=1)]
    for folder in folders:
        evaluate_run(folder)
    metrics = json.loads((folders[0] / "metrics.json").read_text())
    files = ("tum", folders[0] / "ground_truth.tum", folders[0] / "trajectory_online.tum", "-a")
    metre = ("--delta", "1", "--delta_unit", "m", "--pairs_from_reference", "-r", "angle_deg")
    evo(tmp_path, "evo_rpe", *files, *metre, "--save_results", tmp_path / "rpe.zip")
    assert metrics["rpe_1m_rot"] == pytest.approx(load_res_file(tmp_path / "rpe.zip").stats, rel=1e-6)

    table = tmp_path / "table.csv"
    evo(tmp_path, "evo_res", *(folder / "rpe_trans.zip" for folder in folders), "--save_table", table)
    rows = dict(line.split(",", 1) for line in table.read_text().splitlines()[1:])
    assert set(rows) == {"first", "second"}
    assert f"{metrics['rpe_trans']['rmse']:.9f}"[:9] in rows["first"]


def test_errors_of_a_noisy_run_are_those_put_in(make_run: MakeRun) -> None:
    evaluation = evaluate_run(make_run())
    rmse = {name: evaluation.errors[name].stats["rmse"] for name in ERRORS}
    assert rmse["rpe_trans"] == pytest.approx(0.01 * np.sqrt(3), rel=0.1)
    assert rmse["rpe_rot"] == pytest.approx(np.degrees(2e-4) * np.sqrt(3), rel=0.1)
    assert 0.02 < rmse["ape_trans"] < 1
    assert 0.005 < rmse["ape_rot"] < 1
    assert evaluation.coverage == 1
    assert evaluation.scale == pytest.approx(1, abs=5e-3)
    assert 0.01 < evaluation.drift.t_rel < 1
    assert evaluation.consistency is not None
    assert evaluation.consistency.count == 239  # neither the first frame nor the ten coasted ones
    assert evaluation.consistency.low < evaluation.consistency.mean < evaluation.consistency.high
    assert evaluation.notes == ()


def test_a_scale_error_is_found_and_taken_out(make_run: MakeRun) -> None:
    folder = make_run(gain=0.8)
    as_it_is, corrected = evaluate_run(folder), evaluate_run(folder, align=Alignment.SIM3)
    assert as_it_is.scale == corrected.scale == pytest.approx(1.25, rel=5e-3)
    assert as_it_is.drift.t_rel == corrected.drift.t_rel == pytest.approx(20, abs=1)
    assert 0.01 < as_it_is.drift_scaled.t_rel < 1
    assert as_it_is.errors["ape_trans"].stats["rmse"] > 10 * corrected.errors["ape_trans"].stats["rmse"]
    assert as_it_is.consistency is not None and corrected.consistency is not None
    assert as_it_is.consistency.mean > 50 > 7 > corrected.consistency.mean > 2


@pytest.mark.parametrize(("align", "close"), [("none", False), ("origin", True), ("se3", True), ("sim3", True)])
def test_alignment_brings_the_worlds_together(align: str, close: bool) -> None:
    truth = drive(60)
    error = evaluate(truth.from_origin(), truth, Alignment(align)).errors["ape_trans"].stats["max"]
    distance = float(np.linalg.norm(WORLD_T_START.translation()))
    assert error < 1e-6 if close else error > distance / 2


def test_without_motion_the_origins_are_aligned() -> None:
    truth = Trajectory(0.1 * np.arange(30), (WORLD_T_START,) * 30)
    turning = tuple(gtsam.Pose3(gtsam.Rot3.Ry(1e-3 * i), np.zeros(3)) for i in range(30))
    evaluation = evaluate(Trajectory(truth.stamps, turning), truth, Alignment.SIM3)
    assert evaluation.alignment is Alignment.ORIGIN
    assert evaluation.errors["ape_rot"].stats["max"] == pytest.approx(np.degrees(0.029), rel=1e-6)
    assert evaluation.errors["ape_trans"].stats["max"] < 1e-9
    assert [note.split(":")[0] for note in evaluation.notes] == [
        "the motion does not determine an alignment by sim3",
        "no relative pose error over 1 m",
        "no t_rel and r_rel",
        "no NEES",
    ]


def test_an_estimate_that_stands_still_is_all_drift() -> None:
    truth = drive(250)
    still = Trajectory(truth.stamps, (gtsam.Pose3(),) * 250)
    evaluation = evaluate(still, truth)
    assert 95 < evaluation.drift.t_rel <= 101.1
    assert np.isnan([evaluation.scale, evaluation.drift_scaled.t_rel]).all()


def test_metrics_json_has_null_for_what_is_not_known(tmp_path: Path) -> None:
    truth = drive(30)
    evaluate(truth.from_origin(), truth).write(tmp_path / "new")
    metrics = json.loads((tmp_path / "new" / "metrics.json").read_text())
    assert (metrics["frames"], metrics["coverage"], metrics["nees"]) == (None, None, {})
    assert (metrics["drift"]["t_rel"], metrics["drift"]["segments"]) == (None, 0)
    assert (metrics["associated"], metrics["poses"], metrics["alignment"]) == (30, 30, "se3")
    assert {path.stem for path in (tmp_path / "new").glob("*.zip")} == set(ERRORS)
    assert len(Trajectory.read_tum(tmp_path / "new" / "reference.tum")) == 30


def test_a_partial_run_is_evaluated_as_far_as_it_came(make_run: MakeRun) -> None:
    with pytest.raises(KeyboardInterrupt):
        make_run("partial", truth=drive(60), stop=KeyboardInterrupt(), frames=240)
    folder = make_run("killed", truth=drive(60), frames=240)
    (folder / "covariances.npz").unlink()
    for name in ("partial", "killed"):
        evaluation = evaluate_run(folder.parent / name)
        assert evaluation.coverage == 0.25
        assert (evaluation.consistency is None) == (name == "killed")


def test_files_of_other_programs_are_evaluated(tmp_path: Path) -> None:
    truth = drive(150)
    truth.write_tum(tmp_path / "truth.tum")
    truth.from_origin().write_kitti(tmp_path / "other.kitti")
    evaluation = evaluation_of(tmp_path / "other.kitti", tmp_path / "truth.tum")
    assert (evaluation.name, evaluation.coverage) == ("other", None)
    assert evaluation.errors["ape_trans"].stats["max"] < 1e-6
    assert evaluation.drift.t_rel == pytest.approx(0, abs=1e-9)


def test_what_cannot_be_evaluated_is_one_sentence(tmp_path: Path, make_run: MakeRun) -> None:
    folder = make_run(truth=drive(10), ground_truth=False)
    with pytest.raises(ResultsError, match="has no ground truth; give a reference"):
        evaluate_run(folder)
    shifted(drive(10), 1e6).write_tum(tmp_path / "later.tum")
    with pytest.raises(TrajectoryError, match="0 of 10 poses have a reference"):
        evaluate_run(folder, tmp_path / "later.tum")
    (folder / "metrics.json").mkdir()
    drive(10).write_tum(tmp_path / "truth.tum")
    with pytest.raises(ResultsError, match="cannot be written"):
        evaluate_run(folder, tmp_path / "truth.tum")


def test_kitti_ground_truth_of_the_benchmark(real_data) -> None:
    """A trajectory of 350 poses in KITTI's format is its own perfect estimate, also with noise in its last digits."""
    poses = real_data("kitti_odometry") / "poses" / "03.txt"
    evaluation = evaluation_of(poses, poses)
    assert evaluation.errors["ape_trans"].stats["max"] < 1e-6
    assert evaluation.drift.segments == 30
    assert evaluation.drift.t_rel < 1e-6


def test_status_decides_what_counts_as_tracked(make_run: MakeRun) -> None:
    run = read_run(make_run())
    run.frames["status"][:] = Status.COASTED.value
    assert evaluation_of(run).consistency is None
