"""The factor graph, fed with motions and landmarks of simulated scenes; see conftest."""

from itertools import count
from pathlib import Path

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.errors import EstimationError
from fvslam_graph.core.frame_result import FACTORS, G2O, LANDMARKS_PLY, VALUES
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.vo_estimate import OdometryStep
from fvslam_graph.graph.calibration import CALIBRATION
from fvslam_graph.graph.factor_graph import Graph
from fvslam_graph.graph.factors import LandmarkFactors, is_landmark, landmark_key, pose_key, position_factor
from fvslam_graph.graph.solver import Solver

from .conftest import MOTION, PIXEL, error_of

SEEN = LandmarkFactors(Camera(640, 480, 450, 450, 320, 240), GraphSettings(kernel="none"))
SEEDS = range(5)
MANY = range(10, 40)


@pytest.mark.parametrize("odometry", ["between", "essential"])
@pytest.mark.parametrize("landmarks", ["projection", "bearing_range", "smart", "none"])
def test_without_noise_without_error(fed, odometry, landmarks):
    made = fed(frames=51, noise=0.0, odometry=odometry, landmarks=landmarks)  # long enough to sum landmarks up
    assert made.error() < 1e-6
    for first, second, motion in made.motions:
        assert np.abs(error_of(made.scene, first, second, motion.mean)).max() < 1e-6


def test_landmarks_make_it_better(error_fed):
    assert GraphSettings().landmarks == "projection"
    with_landmarks = np.mean([error_fed(seed=seed) for seed in SEEDS])
    without = np.mean([error_fed(seed=seed, landmarks="none") for seed in SEEDS])
    assert 0.02 < with_landmarks < 0.95 * without  # metres; measured 0.071 and 0.084


def test_as_good_as_the_batch_optimum(fed):
    """While frames come; in the end it is this optimum."""
    online, best = [], []
    for seed in SEEDS:
        made = fed(seed=seed)
        factors, values = made.graph.solver.factors(), made.graph.solver.values()
        positions = np.array([values.atPose3(pose_key(index)).translation() for index in range(len(made.scene))])
        online.append(np.sqrt(((positions - made.scene.trajectory.positions) ** 2).sum(axis=1).mean()))
        batch = gtsam.LevenbergMarquardtOptimizer(factors, values, gtsam.LevenbergMarquardtParams()).optimize()
        assert factors.error(values) <= 1.05 * factors.error(batch)  # measured up to 1.035
        best.append(made.error())
        optimum = made.graph.solver.values()
        assert factors.error(optimum) == pytest.approx(factors.error(batch), rel=1e-5)
    assert np.mean(online) < 1.1 * np.mean(best)  # measured 0.0605 and 0.0597 m


@pytest.mark.parametrize("seeds", [range(10), pytest.param(MANY, marks=pytest.mark.slow)])
def test_motions_and_covariances_are_consistent(fed, seeds):
    """NEES of the motions from fusion to fusion; independent seeds, so that the band is a wide one."""
    values = []
    for seed in seeds:
        made = fed(seed=seed, kernel="none")
        for first, second, motion in made.motions[2:]:
            error = error_of(made.scene, first, second, motion.mean)
            values.append(error @ np.linalg.solve(motion.covariance, error))
    assert 4.5 < np.mean(values) < 7.5  # six degrees of freedom


@pytest.mark.parametrize("shared", [{}, {"common_noise": GraphSettings().common_noise}], ids=["own", "shared"])
def test_a_fifth_of_gross_outliers(error_fed, shared):
    """In odometry and landmarks, after a clean start; a path may be lost where last bits decide."""
    clean = np.median([error_fed(seed=seed, **shared) for seed in SEEDS])
    wrong = np.array([error_fed(seed=seed, wrong=0.2, **shared) for seed in range(11)])
    assert np.median(wrong) < 2 * clean  # measured 1.0 to 1.6 on three kinds of processors
    assert np.sum(wrong > 4 * clean) <= 1  # measured none in 20


def test_gross_outliers_within_a_lag(fed):
    """Also one that is shorter than the time between fusions."""
    for lag in (0.1, 1.0):
        made = fed(frames=31, seed=1, wrong=0.2, lag=lag)
        assert len(made.graph.smoothed()) == 31 and np.isfinite(made.error())


def test_darkness(fed):
    """Without landmarks and with odometry that only guesses, the covariance grows; then it is found again."""
    made = fed(frames=61, seed=2, dark=range(21, 41))
    spread = {second: np.trace(motion.covariance) for _, second, motion in made.motions}
    assert spread[30] > 10 * spread[20]
    assert spread[60] < 0.1 * spread[30]


@pytest.mark.parametrize(
    ("recognised", "seeds"),
    [
        (True, SEEDS),
        (False, range(3)),
        pytest.param(True, MANY, marks=pytest.mark.slow),
        pytest.param(False, MANY, marks=pytest.mark.slow),
    ],
)
def test_darkness_of_ten_updates(fed, recognised, seeds):
    """Landmarks seen before may be seen again, and tell where the camera turned; where none are, the path is loose.

    In both, what landmarks say is what it is without summing up, and all that are kept are determined.
    """
    turns, noises = [], []
    for seed in seeds:
        graph = fed(frames=101, seed=seed, dark=range(41, 61), recognised=recognised, count=80).graph
        assert graph.solver.recovered == []
        turns.append(np.sqrt(np.trace(graph.pose(100).covariance[:3, :3])))
        noises.append(graph._noise.sigma)
    if recognised:  # by two to ten landmarks, among which the path takes a while to swing into place
        assert np.median(turns) < 0.5  # rad; measured 0.004 to 0.10
        assert PIXEL / 2 < np.quantile(noises, 0.25) < 4 * PIXEL  # measured 0.39 to 0.57
    else:
        assert min(turns) > 1  # measured 2.32, which is what was guessed
        assert PIXEL / 2 < min(noises) < max(noises) < 2 * PIXEL  # measured 0.27 to 0.31


def test_a_fixed_lag_keeps_what_it_needs(fed):
    whole, lagged = fed(frames=61, seed=3), fed(frames=61, seed=3, lag=2.0)
    poses = [key for key in lagged.graph.solver.values().keys() if gtsam.Symbol(key).chr() == ord("x")]  # noqa: SIM118
    assert len(poses) <= 22  # two seconds at 10 Hz
    assert len(lagged.graph.smoothed()) == 61
    for (_, _, a), (_, _, b) in zip(whole.motions, lagged.motions, strict=True):
        assert a.mean.equals(b.mean, 0.02)


def test_where_nothing_helps_a_lagged_graph_begins_anew(fed, monkeypatch, tmp_path, caplog):
    """A camera that flies cannot wait for a graph that can be solved."""
    advance, begin, calls, failing = Solver._advance, Solver._begin_where_it_was, count(), [True]

    def stuck(solver, *update):
        advance(solver, *update)
        if next(calls) > 26 and failing[0]:  # of 30 fusions
            raise RuntimeError("Indeterminate linear system")

    def begun(solver, values):
        failing[0] = False
        begin(solver, values)

    monkeypatch.setattr(Solver, "_advance", stuck)
    monkeypatch.setattr(Solver, "_begin_where_it_was", begun)
    made = fed(frames=61, seed=3, lag=2.0)
    assert "it begins anew where the camera was" in caplog.text
    assert len(made.graph.smoothed()) == 61
    assert made.error() < 0.5  # metres; measured 0.1
    monkeypatch.undo()
    whole = fed(frames=61, seed=3, lag=2.0)
    lost, kept = (run.graph.pose(60).covariance for run in (made, whole))
    assert np.trace(lost[3:, 3:]) > 0.3 * np.trace(kept[3:, 3:])  # where it was lost, it is not known better
    made.graph.write(tmp_path)


def test_a_lag_that_is_shorter_than_an_interval(fed):
    """As after a gap in a recording: what was fused before is left behind, odometry goes on."""
    made = fed(frames=31, seed=3, lag=0.15)
    assert [motion for _, _, motion in made.motions] == [None] * len(made.motions)
    assert len(made.graph.smoothed()) == 31
    assert 0.01 < made.error() < 0.3  # metres; measured 0.12


def test_standing_still_for_longer_than_the_lag():
    """Odometry refers to the frame where the camera came to rest, for as long as it rests."""
    camera = Camera(640, 480, 450.0, 450.0, 319.5, 239.5)
    graph = Graph(camera, GraphSettings(lag=2.0))
    turned = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, 0.2, 0.3), np.zeros(3))
    for index in range(161):
        graph.add_odometry(
            0.1 * index, OdometryStep(0, GaussianPose(turned if index else gtsam.Pose3(), 1e-6 * np.eye(6)))
        )
        if index and index % 5 == 0:
            graph.fuse(None)
    smoothed = graph.smoothed()
    assert np.abs(smoothed.positions).max() < 1e-6
    assert smoothed.poses[-1].equals(turned, 1e-3)
    matrix = smoothed.poses[-1].rotation().matrix()
    assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-9)


def _camera_enters(factors, values):
    for factor in SEEN.calibration.priors():
        factors.add(factor)
    values.insert(CALIBRATION, SEEN.calibration.start)


def test_a_variable_that_is_not_determined_is_named_and_held(caplog):
    solver, position = Solver(GraphSettings()), np.array([0.0, 0.0, 5.0])
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.add(gtsam.PriorFactorPose3(pose_key(0), gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 0.1)))
    factors.add(position_factor(1, position, 1.0))
    values.insert(pose_key(0), gtsam.Pose3())
    values.insert(pose_key(1), gtsam.Pose3(gtsam.Rot3(), position))
    solver.update(factors, values, {pose_key(0): 0.0, pose_key(1): 0.0})
    assert solver.recovered == ["x1"]
    assert "x1 is not determined" in caplog.text
    assert solver.pose(pose_key(1)).translation() == pytest.approx(position)


@pytest.mark.parametrize(("point", "kept"), [([0.0, 0.0, 4.0], True), ([0.0, 0.0, -4.0], False), ([0, 0, 1e9], False)])
def test_a_landmark_that_steps_behind_a_camera_is_left_out(point, kept):
    """There a projection says nothing of it, so that once linearised it would not be determined."""
    solver = Solver(GraphSettings())
    factors, values, key = gtsam.NonlinearFactorGraph(), gtsam.Values(), landmark_key(7)
    _camera_enters(factors, values)
    factors.add(gtsam.PriorFactorPose3(pose_key(0), gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 0.1)))
    factors.add(SEEN.projection(0, 7, np.array([320.0, 240.0]), 1.0, 0))
    factors.add(gtsam.PriorFactorPoint3(key, np.array(point), gtsam.noiseModel.Isotropic.Sigma(3, 0.1)))
    values.insert(pose_key(0), gtsam.Pose3())
    values.insert(key, np.array([0.0, 0.0, 5.0]))
    solver.update(factors, values, {CALIBRATION: 0.0, pose_key(0): 0.0, key: 0.0})
    assert (solver.has(key), solver.values().exists(key), solver.factors().nrFactors()) == (
        kept,
        kept,
        6 if kept else 4,
    )
    assert solver.recovered == []
    solver.optimize()
    assert solver.pose(pose_key(0)).equals(gtsam.Pose3(), 1e-6)


def test_a_landmark_that_no_prior_helps_is_dropped(caplog):
    """As by a pixel that is not a number; what was known before stays, and all can be solved again."""
    solver = Solver(GraphSettings())
    poses = [gtsam.Pose3(gtsam.Rot3(), np.array([0.5 * index, 0.0, 0.0])) for index in range(3)]
    first = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)

    def see(factors, index, landmark, pixel):
        factors.add(SEEN.projection(index, landmark, np.array(pixel), 1.0, 0))

    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    _camera_enters(factors, values)
    factors.add(gtsam.PriorFactorPose3(pose_key(0), poses[0], first))
    factors.add(gtsam.BetweenFactorPose3(pose_key(0), pose_key(1), poses[0].between(poses[1]), first))
    see(factors, 0, 7, [320.0, 240.0])
    see(factors, 1, 7, [275.0, 240.0])
    for index in (0, 1):
        values.insert(pose_key(index), poses[index])
    values.insert(landmark_key(7), np.array([0.0, 0.0, 5.0]))
    solver.update(factors, values, {CALIBRATION: 0.0, pose_key(0): 0.0, pose_key(1): 0.1, landmark_key(7): 0.1})

    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.add(gtsam.BetweenFactorPose3(pose_key(1), pose_key(2), poses[1].between(poses[2]), first))
    see(factors, 2, 8, [np.nan, 240.0])
    values.insert(pose_key(2), poses[2])
    values.insert(landmark_key(8), np.array([1.0, 0.0, 6.0]))
    solver.update(factors, values, {pose_key(2): 0.2, landmark_key(8): 0.2})
    assert "without the 1 landmarks" in caplog.text
    assert solver.has(landmark_key(7)) and not solver.has(landmark_key(8))
    solver.optimize()
    assert solver.pose(pose_key(2)).equals(poses[2], 1e-3)


def test_written_and_read_back(fed, tmp_path):
    made = fed(seed=1)
    made.graph.smoothed()
    made.graph.write(tmp_path)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.deserialize((tmp_path / FACTORS).read_text())
    values.deserialize((tmp_path / VALUES).read_text())
    kept = made.graph.solver
    assert factors.error(values) == pytest.approx(kept.factors().error(kept.values()), rel=1e-9)
    assert factors.error(values) > 1
    motions, poses = gtsam.readG2o(str(tmp_path / G2O), True)
    assert poses.size() == len(made.scene) and motions.size() == len(made.scene) - 1
    assert poses.atPose3(40).equals(kept.pose(pose_key(40)), 1e-4)
    lines = (tmp_path / LANDMARKS_PLY).read_text().splitlines()
    landmarks = [key for key in values.keys() if is_landmark(key)]  # noqa: SIM118
    assert len(lines) - lines.index("end_header") - 1 == len(landmarks) > 10


@pytest.mark.parametrize(
    ("kind", "written"),
    [
        ({"landmarks": "bearing_range"}, True),
        ({"landmarks": "smart"}, True),
        ({"landmarks": "none"}, True),
        *(({"kernel": kernel}, True) for kernel in ("huber", "geman_mcclure", "none")),
        ({"lag": 2.0}, True),
        ({"odometry": "essential"}, False),
    ],
)
def test_every_kind_of_graph_is_written(fed, tmp_path, kind, written):
    made = fed(frames=21, **kind)
    made.graph.write(tmp_path)
    assert (tmp_path / FACTORS).exists() == written
    values = gtsam.Values()
    values.deserialize((tmp_path / VALUES).read_text())
    assert values.size() > 5
    if written:
        factors = gtsam.NonlinearFactorGraph()
        factors.deserialize((tmp_path / FACTORS).read_text())
        assert factors.size() > 5


def test_the_same_bits(fed):
    a, b = fed(seed=4), fed(seed=4)
    assert np.array_equal(a.graph.smoothed().matrices, b.graph.smoothed().matrices)


def test_satellites_bound_the_drift(fed):
    """A position every ten frames, as an optional factor."""
    made = fed(seed=1, landmarks="none")
    camera, poses = made.scene.camera, made.scene.trajectory.poses
    graph, rng = Graph(camera, GraphSettings(landmarks="none")), np.random.default_rng([1, 4])
    for index in range(len(poses)):
        previous = max(index - 1, 0)
        motion = poses[previous].between(poses[index]).retract(20 * MOTION * rng.standard_normal(6))
        graph.add_odometry(0.1 * index, OdometryStep(previous, GaussianPose(motion, 400 * np.diag(MOTION**2))))
        if index and index % 10 == 0:
            graph.add(position_factor(index, poses[index].translation() + 0.05 * rng.standard_normal(3), 0.05))
    graph.fuse(None)
    off = np.linalg.norm(graph.smoothed().positions - made.scene.trajectory.positions, axis=1)
    assert off[[10, 20, 30, 40]].max() < 0.2 < 5 * off.max()


def test_heights_bound_the_climb(fed):
    made = fed(frames=11, seed=1)
    graph, poses = Graph(made.scene.camera, GraphSettings()), made.scene.trajectory.poses
    down = np.array([0.0, 1.0, 0.0])
    for index in range(11):
        motion = poses[max(index - 1, 0)].between(poses[index])
        climbing = gtsam.Pose3(motion.rotation(), motion.translation() - 0.3 * down * (index > 0))
        graph.add_odometry(
            0.1 * index, OdometryStep(max(index - 1, 0), GaussianPose(climbing, np.diag([1e-4] * 3 + [1.0] * 3)))
        )
        graph.add_height(1.65, 0.02, down)
    graph.fuse(None)
    assert graph.smoothed().positions[:, 1] == pytest.approx(np.zeros(11), abs=0.05)
    spread = graph.pose(10).covariance[3:, 3:]
    assert spread[1, 1] < 0.01 < spread[0, 0]


class Indeterminate:
    """iSAM2 that has no estimate of all variables, as where one is not determined."""

    def __init__(self, solver):
        self.solver = solver

    def __getattr__(self, name):
        return getattr(self.solver, name)

    def calculateEstimate(self):
        raise RuntimeError("Indeterminate linear system detected while working near variable 1")


def test_the_path_is_smoothed_where_a_variable_is_not_determined(fed, monkeypatch):
    best = fed(frames=21).graph.smoothed()
    graph = fed(frames=21).graph
    graph.solver._solver = Indeterminate(graph.solver._solver)
    monkeypatch.setattr(Solver, "_empty", lambda self, empty=Solver._empty: Indeterminate(empty(self)))
    smoothed = graph.smoothed()
    assert np.abs(smoothed.matrices - best.matrices).max() < 1e-3  # of 20 m


def test_poses_that_are_not_determined_are_left_out(fed, monkeypatch):
    graph = fed(frames=21).graph

    def values(self, values=Solver.values):
        found = values(self)
        found.update(pose_key(7), gtsam.Pose3(gtsam.Rot3(), np.full(3, np.nan)))
        return found

    monkeypatch.setattr(Solver, "values", values)
    monkeypatch.setattr(Solver, "optimize", lambda self: None)
    smoothed = graph.smoothed()
    assert len(smoothed) == graph.frames - 1 and 0.7 not in smoothed.stamps


def test_a_graph_that_cannot_be_solved_says_so_again(fed):
    """What it could not take in is not taken in twice, and the first reason stands."""
    graph = fed(frames=5).graph
    graph.add_odometry(0.5, OdometryStep(4, GaussianPose(gtsam.Pose3(), np.diag(MOTION**2))))
    graph.add(gtsam.PriorFactorPose3(pose_key(99), gtsam.Pose3(), gtsam.noiseModel.Unit.Create(6)))
    for _ in range(2):
        with pytest.raises((EstimationError, RuntimeError, ValueError, IndexError)) as caught:
            graph.fuse(None)
        assert "already exists" not in str(caught.value)


def test_a_disk_that_is_full_for_gtsam(fed, tmp_path, monkeypatch):
    """Its writer does not say so."""

    def cut(factors, values, path, write=gtsam.writeG2o):
        write(factors, values, path)
        Path(path).write_text(Path(path).read_text()[:-30])

    monkeypatch.setattr(gtsam, "writeG2o", cut)
    graph = fed(frames=5).graph
    graph.smoothed()
    with pytest.raises(OSError, match="No space left on device"):
        graph.write(tmp_path)
    assert not (tmp_path / G2O).exists()
