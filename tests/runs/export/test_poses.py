"""Covariances along fixed axes, and the simple formats: CSV and the ASL layout."""

import csv
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from evo.tools import file_interface

import fvslam_graph
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.runs.export.csv_table import CSV_COLUMNS
from fvslam_graph.runs.export.poses import ExportedPoses


def test_fixed_axes_are_what_a_small_error_does_in_the_world(run):
    pose, sigma = run.online.poses[3], 1e-6
    for axis in range(6):
        error = sigma * np.eye(6)[axis]
        off = pose.compose(gtsam.Pose3.Expmap(error))
        moved = off.translation() - pose.translation()
        turned = gtsam.Rot3.Logmap(off.rotation().compose(pose.rotation().inverse()))
        seen = np.concatenate([moved, turned])
        one = ExportedPoses(
            run, Trajectory(np.zeros(1), (pose,)), np.array([3]), np.outer(error, error)[None], smoothed=False
        )
        assert np.allclose(one.fixed_axes_covariances[0], np.outer(seen, seen), rtol=0, atol=1e-17)


def test_rotational_noise_lands_in_the_block_of_rotations(run):
    # The camera's x axis is the world's z axis.
    pose = gtsam.Pose3(gtsam.Rot3(np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])), np.array([10.0, 20, 30]))
    covariance = np.diag([0.04, 0, 0, 0, 0, 0])
    poses = ExportedPoses(run, Trajectory(np.zeros(1), (pose,)), np.array([0]), covariance[None], smoothed=False)
    assert np.allclose(poses.fixed_axes_covariances[0], np.diag([0, 0, 0, 0, 0, 0.04]), rtol=0, atol=1e-15)


def test_the_table_has_all_digits(run, tmp_path):
    path = fvslam_graph.export(run, "csv", tmp_path / "poses.csv").path
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == list(CSV_COLUMNS) and [row["status"] for row in rows] == run.frames["status"].tolist()
    for row, pose, covariance in zip(rows, run.online.poses, run.pose_covariances, strict=True):
        assert [float(row[name]) for name in "xyz"] == pose.translation().tolist()
        rotation = gtsam.Rot3.Quaternion(*(float(row[f"q{name}"]) for name in "wxyz"))
        assert rotation.equals(pose.rotation(), 1e-12)
        read = np.array([float(value) for name, value in row.items() if name.startswith("cov_")]).reshape(6, 6)
        assert np.array_equal(read, covariance)
    assert rows[0]["stamp"] == "1403636579.750000000"


def test_the_asl_layout_is_read_by_evo(run, tmp_path):
    fvslam_graph.export(run, "euroc", tmp_path / "flight")
    folder = tmp_path / "flight" / "mav0" / "state_groundtruth_estimate0"
    read = file_interface.read_euroc_csv_trajectory(folder / "data.csv")
    assert np.allclose(read.timestamps, run.online.stamps, rtol=0, atol=1e-6)
    assert np.allclose(read.poses_se3, run.online.matrices, rtol=0, atol=1e-9)
    assert np.allclose(Trajectory.read_tum(folder / "data.csv").matrices, run.online.matrices, rtol=0, atol=1e-9)
    assert "T_BS" in (folder / "sensor.yaml").read_text()


def test_smoothed_poses_keep_the_numbers_of_their_frames(run):
    kept = [1, 2, 5]
    smoothed = Trajectory(run.online.stamps[kept] + 3e-10, tuple(run.online.poses[n] for n in kept))
    poses = ExportedPoses.of(replace(run, smoothed=smoothed), smoothed=True)
    assert poses.frames.tolist() == kept and poses.covariances is None
    assert poses.statuses == ["tracked"] * 3


@pytest.mark.parametrize("stamp", [0.0, -0.5, 1403636579.763555527])
def test_nanoseconds_are_those_of_the_stamp(run, stamp):
    poses = ExportedPoses(run, Trajectory(np.array([stamp]), (gtsam.Pose3(),)), np.array([0]), None, smoothed=False)
    assert poses.nanoseconds == [round(stamp) * 10**9 + round((stamp - round(stamp)) * 1e9)]
