"""Other people's trajectories get the row that they deserve."""

import numpy as np
import pytest

from fvslam_graph.core.errors import TrajectoryError
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.study.external import external_row, external_run


@pytest.fixture(scope="module")
def sequence(drive):
    return open_sequence(drive)


def part(trajectory, rows, stamps=None):
    return Trajectory(trajectory.stamps[rows] if stamps is None else stamps, tuple(trajectory.poses[i] for i in rows))


def test_files_of_all_kinds_are_associated(sequence, tmp_path):
    truth = sequence.ground_truth
    truth.write_kitti(tmp_path / "all.kitti")
    part(truth, range(2, 11)).write_tum(tmp_path / "some.tum")
    rows = np.arange(3, 9)
    part(truth, rows, 0.05 * rows).write_tum(tmp_path / "counted.tum")  # fed at 20 Hz, recorded at 10
    for file, frames in (("all.kitti", range(12)), ("some.tum", range(2, 11)), ("counted.tum@0.05", rows)):
        row, run = external_row("other", f"{tmp_path}/{file}", sequence, Alignment.SIM3)
        assert (row["mode"], row["preset"], row["status"]) == ("other", "external", "finished")
        assert run.online.stamps.tolist() == sequence.stamps[list(frames)].tolist()
        assert row["ape"] < 1e-6 and row["associated"] == len(frames)
        assert row["coverage"] == pytest.approx(len(frames) / 12)


def test_files_of_another_sequence(sequence, tmp_path):
    truth = sequence.ground_truth
    part(truth, range(6)).write_kitti(tmp_path / "short.kitti")
    Trajectory(truth.stamps + 100, truth.poses).write_tum(tmp_path / "late.tum")
    with pytest.raises(TrajectoryError, match="a pose for each of the 12 frames of drive, not 6"):
        external_run("other", f"{tmp_path}/short.kitti", sequence)
    row, run = external_row("other", f"{tmp_path}/late.tum", sequence, Alignment.SIM3)
    assert run is None and row["status"].startswith("failed: 0 of 12 poses have a reference")
    Trajectory(np.rint(1e9 * truth.stamps), truth.poses).write_tum(tmp_path / "nanoseconds.tum")
    row, _ = external_row("other", f"{tmp_path}/nanoseconds.tum", sequence, Alignment.SIM3)
    assert "seem to be nanoseconds" in row["status"]  # although the first stamp of both is 0
    with pytest.raises(TrajectoryError, match=r"its poses are for frames 1000 to 1011; use the stamps"):
        external_run("other", f"{tmp_path}/late.tum@0.1", sequence)
    row, _ = external_row("other", f"{tmp_path}/absent.tum", sequence, Alignment.SIM3)
    assert "absent.tum" in row["status"]


def test_a_trajectory_is_cut_to_the_frames(drive, tmp_path):
    """Of the whole recording, at ten times its rate, beside a study of a part of it."""
    part_of = open_sequence(drive, frames="3:9", stride=2)
    truth = part_of.ground_truth
    truth.interpolate(np.arange(0, 1.1, 0.01)).write_tum(tmp_path / "dense.tum")
    row, run = external_row("other", f"{tmp_path}/dense.tum", part_of, Alignment.SIM3)
    assert run.online.stamps == pytest.approx(part_of.stamps)
    assert (row["frames"], row["coverage"], row["associated"]) == (3, 1, 3)
    part(truth, [4]).write_tum(tmp_path / "one.tum")
    row, _ = external_row("other", f"{tmp_path}/one.tum", part_of, Alignment.SIM3)
    assert row["status"].startswith("failed: ")
