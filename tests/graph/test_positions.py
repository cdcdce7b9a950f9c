"""Positions by a GNSS receiver, held against a path whose motions drift."""

from dataclasses import dataclass

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.sequence import Ground
from fvslam_graph.core.vo_estimate import OdometryStep
from fvslam_graph.graph.factor_graph import Graph
from fvslam_graph.graph.factors import ENU, pose_key
from fvslam_graph.graph.positions import GraphFix, enu_factor
from fvslam_graph.simulation.gnss import ENU_R_CAMERA
from fvslam_graph.simulation.points import simulate_drive

MOTION = np.repeat([0.0005, 0.01], 3)  # rad and m, noise of a motion from frame to frame
START = gtsam.Pose3(gtsam.Rot3(ENU_R_CAMERA), np.array([5.0, -7.0, 3.0])) * gtsam.Pose3(gtsam.Rot3.Ry(2.0), np.zeros(3))


@dataclass(frozen=True)
class Placed:
    """What a graph says of places on Earth, against the truth."""

    graph: Graph
    online: np.ndarray  # (N, 3) errors at interleaved frames
    nees: np.ndarray  # (N,)
    smoothed: float  # RMS


def placed(seed: int = 0, sigma: float = 1.5, wrong: float = 0.2, late: float = 0.0, **settings: object) -> Placed:
    """A drive of 20 s with a fix a second, `late` seconds before the frame that it comes with, and a gap of 5 s."""
    truth = simulate_drive(frames=200, seed=seed, landmarks=300).trajectory
    rng = np.random.default_rng([seed, 9])
    graph = Graph(
        simulate_drive(frames=2).camera, GraphSettings(landmarks="none", **settings), ground=Ground.below(1.6)
    )
    true = [START * truth.poses[0].between(pose) for pose in truth.poses]
    online, nees = [], []
    for index, stamp in enumerate(truth.stamps.tolist()):
        previous = max(index - 1, 0)
        motion = truth.poses[previous].between(truth.poses[index]).retract(MOTION * rng.standard_normal(6))
        graph.add_odometry(stamp, OdometryStep(previous, GaussianPose(motion, np.diag(MOTION**2))))
        if index % 10 == 1 and not 9 < stamp < 14:
            step = truth.stamps[index] - truth.stamps[previous]
            there = true[previous].translation() * late / step + true[index].translation() * (1 - late / step)
            off = 50.0 * (rng.random() < wrong) * gtsam.Unit3(rng.standard_normal(3)).point3()
            graph.add_position(stamp - late, there + sigma * rng.standard_normal(3) + off, np.full(3, sigma))
        if index % 5 == 0 and index > 0:
            graph.fuse(None)
            if (pose := graph.enu_T_camera(index)) is not None:
                rotation = pose.mean.rotation().matrix()
                online.append(pose.mean.translation() - true[index].translation())
                nees.append(online[-1] @ np.linalg.solve(rotation @ pose.covariance[3:, 3:] @ rotation.T, online[-1]))
    smoothed, enu_T_world = graph.smoothed(), graph.enu_T_world()
    rest = enu_T_world.mean.transformFrom(smoothed.positions.T).T - [pose.translation() for pose in true]
    return Placed(graph, np.array(online), np.array(nees), float(np.sqrt((rest**2).sum(axis=1).mean())))


def test_positions_on_earth_are_consistent_whatever_is_wrong():
    runs = [placed(seed) for seed in range(8)]
    mean = np.mean([run.nees.mean() for run in runs])
    assert 1.2 < mean < 5.5  # measured: 2.8; 3 is expected, errors of one run are nearly one error
    assert np.sqrt(np.mean([run.smoothed**2 for run in runs])) < 1.6  # 0.9 is what 12 fixes of 1.5 m tell at best


def test_better_fixes_give_better_places():
    assert placed(sigma=0.1).smoothed < 0.2  # measured: 0.05


def test_fixes_between_frames_are_where_the_camera_was_then():
    late = placed(sigma=0.05, wrong=0.0, late=0.07)
    assert late.smoothed < 0.15  # measured: 0.03; at 10 m/s, 0.07 s are 0.7 m


def test_within_a_lag():
    run = placed(lag=4.0)
    assert len(run.online) > 20
    assert 0.3 < run.nees.mean() < 12  # one run
    assert not run.graph.has(0) and run.graph.solver.has(ENU)


def test_nothing_is_said_of_earth_before_fixes_tell():
    graph = Graph(simulate_drive(frames=2).camera, GraphSettings())
    graph.add_odometry(0.0, OdometryStep(0, GaussianPose.identity()))
    graph.add_position(0.0, np.zeros(3), np.ones(3))
    graph.fuse(None)
    assert graph.world_T_enu is None
    assert graph.enu_T_camera(0) is None and graph.enu_T_world() is None


@pytest.mark.parametrize("away", [0.0, 0.4])
def test_the_factor_measures_the_place_at_the_time_of_the_fix(away):
    pose = gtsam.Pose3(gtsam.Rot3.Ypr(0.3, -0.2, 0.1), np.array([3.0, 4.0, 5.0]))
    world_T_enu = gtsam.Pose3(gtsam.Rot3.Ypr(1.0, 0.1, 0.2), np.array([1.0, -2.0, 0.5]))
    lever = np.array([0.1, 0.0, -0.8])
    there = world_T_enu.transformTo(pose.transformFrom(lever))
    fix = GraphFix(7, there + away * np.array([0.0, 1.0, 0.0]), np.array([0.5, 0.2, 0.5]), lever)
    values = gtsam.Values()
    values.insert(ENU, world_T_enu)
    values.insert(pose_key(7), pose)
    factor = enu_factor(fix, world_T_enu.rotation().between(pose.rotation()), GraphSettings(kernel="none"))
    assert factor.error(values) == pytest.approx((away / 0.2) ** 2 / 2, abs=1e-9)
