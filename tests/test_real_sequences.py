"""The estimators on short parts of real recordings; skipped where they are absent."""

from collections import Counter

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import load_config
from fvslam_graph.core.trajectory import Status, Trajectory
from fvslam_graph.estimator import estimate
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.metrics import EstimateDetails, Evaluation, evaluate
from fvslam_graph.pipeline import resolve_config
from fvslam_graph.sequences.open import open_sequence


def run(path, preset: str = "tuned", frames: str = ":", settings: tuple[str, ...] = ()):
    """The sequence and the result of each of its frames."""
    sequence = open_sequence(path, frames=frames)
    return sequence, list(estimate(sequence, resolve_config(load_config(preset, settings=settings), sequence)))


def compare(sequence, results) -> Evaluation:
    online = Trajectory(sequence.stamps, tuple(result.pose.mean for result in results))
    return evaluate(online, sequence.ground_truth, Alignment.SIM3, EstimateDetails(frames=len(sequence)))


def rmse(evaluation: Evaluation, name: str) -> float:
    return evaluation.errors[name].stats["rmse"]


@pytest.mark.parametrize("preset", ["tuned", "paper"])
def test_kitti_odometry(real_data, preset):
    sequence, results = run(real_data("kitti_odometry") / "sequences" / "03", preset, ":60")
    evaluation = compare(sequence, results)
    assert Counter(result.status for result in results) == {Status.STATIC: 1, Status.TRACKED: 59}
    assert 0.01 < rmse(evaluation, "ape_trans") < 0.4  # metres on 46 m; measured 0.17 and 0.18
    assert evaluation.scale == pytest.approx(1.0, abs=0.04)  # measured 0.992 and 0.997
    assert 0.001 < rmse(evaluation, "rpe_rot") < 0.04  # degrees a frame; measured 0.019 and 0.020


def test_kitti_raw(real_data):
    drive = real_data("kitti_raw") / "2011_09_26" / "2011_09_26_drive_0001_sync"
    sequence, results = run(drive)
    evaluation = compare(sequence, results)
    assert evaluation.coverage == 1
    assert 0.01 < rmse(evaluation, "ape_trans") < 0.2  # measured 0.065
    assert 0.1 < evaluation.drift.t_rel < 3.0  # % over 100 m; measured 1.8
    assert evaluation.drift.r_rel < 0.3  # degrees over 100 m; measured 0.05


def test_small_uav(real_data):
    sequence, results = run(real_data("tello/line"), frames="60:160")
    evaluation = compare(sequence, results)
    assert {result.status for result in results} == {Status.STATIC, Status.TRACKED}
    assert evaluation.coverage == 1
    assert 0.001 < rmse(evaluation, "ape_trans") < 0.04  # metres on 1.5 m; measured 0.015
    assert rmse(evaluation, "rpe_rot") < 0.3  # degrees a frame; measured 0.13


@pytest.mark.parametrize("preset", ["tuned", "paper"])
def test_a_vehicle_that_stands(real_data, preset):
    _, results = run(real_data("euroc_static"), preset)
    assert {result.status for result in results} == {Status.STATIC}
    assert all(np.all(result.pose.mean.translation() == 0) for result in results)
    turned = max(np.linalg.norm(gtsam.Rot3.Logmap(result.pose.mean.rotation())) for result in results)
    assert 0.001 < np.degrees(turned) < 0.2  # measured 0.127 and 0.124


VSLAM = ("mode=vslam",)
FRACTIONAL = (*VSLAM, "slam.motion=odometry", "slam.interleave=5")


@pytest.mark.parametrize(("settings", "landmarks"), [(VSLAM, 25), (FRACTIONAL, 15)])
def test_visual_slam_on_a_street(real_data, settings, landmarks):
    """The first turn of KITTI 03: no reinitialisation, and 1.5 % of 104 m."""
    sequence, results = run(real_data("kitti_odometry") / "sequences" / "03", frames=":150", settings=settings)
    evaluation = compare(sequence, results)
    assert Counter(result.status for result in results) == {Status.STATIC: 1, Status.TRACKED: 149}
    assert 0.02 < rmse(evaluation, "ape_trans") < 1.5  # metres; measured 0.9 and 0.2
    assert rmse(evaluation, "rpe_rot") < 0.15  # degrees a frame; measured 0.07 and 0.05
    measured = [result.measures["measured"] for result in results if result.slam is not None]
    assert np.median(measured) >= landmarks  # measured 25 and 23


def test_visual_slam_on_a_small_uav(real_data):
    sequence, results = run(real_data("tello/line"), frames="20:160", settings=VSLAM)
    evaluation = compare(sequence, results)
    assert evaluation.coverage == 1
    assert Status.REINITIALISED not in {result.status for result in results}
    assert 0.005 < rmse(evaluation, "ape_trans") < 0.15  # metres on 2.5 m


def test_visual_slam_on_a_vehicle_that_stands(real_data):
    """Without a baseline there are no depths to begin with: odometry holds the pose."""
    _, results = run(real_data("euroc_static"), settings=VSLAM)
    assert {result.status for result in results} == {Status.STATIC}
