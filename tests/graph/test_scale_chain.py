"""The scale in the graph: as odometry's filter has it, smoothed, and as the path is published."""

import math
from functools import cache
from itertools import accumulate

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import GraphSettings, ScaleSettings
from fvslam_graph.core.frame_result import FACTORS, G2O, VALUES
from fvslam_graph.core.gaussian_pose import GaussianPose, LogScale
from fvslam_graph.core.inverse_depths import MetricMap
from fvslam_graph.core.sequence import Frame
from fvslam_graph.core.slam_estimate import LandmarkObservations
from fvslam_graph.core.trajectory import Status
from fvslam_graph.core.vo_estimate import OdometryStep, ScaleStep, VoEstimate
from fvslam_graph.evaluation.nees import nees
from fvslam_graph.fusion.graph_fusion import GraphFusion
from fvslam_graph.graph.factor_graph import Graph
from fvslam_graph.graph.factors import length_factor, motion_factor, pose_key, position_factor
from fvslam_graph.graph.pending_update import PendingUpdate
from fvslam_graph.graph.scale_chain import LENGTH_SIGMA, ScaleChain, scale_key
from fvslam_graph.graph.solver import Solver
from fvslam_graph.vo.scale_filter import GroundScale, ScaleFilter

CAMERA = Camera(width=640, height=480, fx=400, fy=400, cx=320, cy=240)
SETTINGS = ScaleSettings()
STEP = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.01, -0.02, 0.05), np.array([0.1, -0.2, 1.5]))
METRES = float(np.linalg.norm(STEP.translation()))
TRUE = list(accumulate([STEP] * 50, gtsam.Pose3.compose, initial=gtsam.Pose3()))
OWN = np.diag(np.repeat([1e-4, 1e-3], 3) ** 2)  # of a motion, without its scale
DRIFT = 0.006  # of log scale per step
NOTHING = LandmarkObservations(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 3)), np.empty((0, 3, 3)))


def steps(count: int, seed: int = 0, height: float = 1.0, height_sigma: float = 0.0) -> list[ScaleStep]:
    """What odometry learns of motions that are all `METRES` long, on a ground that is not quite a plane.

    Its height is in truth so many times that which is given.
    """
    rng = np.random.default_rng(seed)
    scales = ScaleFilter(SETTINGS.model_copy(update={"map_sigma": 1e-9}), height_sigma)
    known, bias, made = LogScale(math.log(METRES), 1.0), 0.0, []
    for number in range(count):
        transition = LogScale(known.mean + DRIFT * rng.standard_normal() * (number > 0), DRIFT**2 if number else 1.0)
        new = SETTINGS.bias_sigma * rng.standard_normal()
        bias = scales.bias_decay * bias + math.sqrt(1 - scales.bias_decay**2) * new
        said = math.log(METRES / height) + bias + SETTINGS.plane_sigma * rng.standard_normal()
        plane = None if number % 7 == 3 else GroundScale(said, 0.0, 1.0)
        if number:
            scales.carry(known.variance, DRIFT**2)
        else:
            scales.begin(1.0)
        known = scales.update(transition.mean, plane)
        measured = plane and plane.measurement(SETTINGS.plane_sigma)
        bias_variance, common = SETTINGS.bias_sigma**2, height_sigma**2
        made.append(ScaleStep(known, transition, measured, bias_variance, scales.bias_decay, common))
    return made


def motion(step: ScaleStep) -> GaussianPose:
    """Of odometry, with its scale."""
    mean = gtsam.Pose3(STEP.rotation(), step.length.metres / METRES * STEP.translation())
    return GaussianPose(mean, OWN).with_scale_variance(step.length.variance)


def fed(made: list[ScaleStep], **settings) -> Graph:
    graph = Graph(CAMERA, GraphSettings(landmarks="none", **settings))
    graph.add_odometry(0.0, OdometryStep(0, GaussianPose.identity()))
    for number, step in enumerate(made):
        graph.add_odometry(0.1 * (number + 1), OdometryStep(number, motion(step), step, step.length.variance))
        if number % 5 == 4:
            graph.fuse(None)
    return graph


@cache
def published(seed: int, online: str) -> list[GaussianPose]:
    """The pose of every frame at its time, over fifty steps."""
    made = steps(50, seed)
    fusion = GraphFusion(CAMERA, GraphSettings(landmarks="none", online=online), None)
    fusion.add_odometry(Frame(0, 0.0, None), OdometryStep(0, GaussianPose.identity(), None, 0.0))
    poses = [fusion.pose]
    for number, step in enumerate(made):
        index = number + 1
        fusion.add_odometry(
            Frame(index, 0.1 * index, None), OdometryStep(number, motion(step), step, step.length.variance)
        )
        if number == 0:
            fusion.start(fusion.pose, NOTHING)
        elif index % 5 == 0:
            fusion.fuse(fusion.pose, fusion.motion, None)
        poses.append(fusion.pose)
    return poses


def lengths(graph: Graph) -> np.ndarray:
    return np.linalg.norm(np.diff(graph.smoothed().positions, axis=0), axis=1)


@pytest.mark.parametrize("height_sigma", [0.0, 0.02])
def test_the_newest_scale_is_that_of_the_filter(height_sigma):
    made = steps(30, height_sigma=height_sigma)
    graph = fed(made)
    newest = scale_key(30)
    assert graph.solver.values().atDouble(newest) == pytest.approx(0, abs=1e-5)
    learnt = height_sigma**2  # share of the height's variance that the first scale, known to 1, takes away in the graph
    assert graph.solver.covariance(newest)[0, 0] == pytest.approx(made[-1].length.variance, rel=1e-4 + learnt)
    assert made[-1].length.variance > height_sigma**2


def test_positions_tell_that_the_given_height_is_wrong():
    """And where there are no more, lengths stay right."""
    graph, place = Graph(CAMERA, GraphSettings(landmarks="none")), gtsam.Pose3()
    graph.add_odometry(0.0, OdometryStep(0, GaussianPose.identity()))
    for index, step in enumerate(steps(150, height=1.04, height_sigma=0.02), 1):
        place = place.compose(STEP)
        graph.add_odometry(0.1 * index, OdometryStep(index - 1, motion(step), step, step.length.variance))
        if index <= 75:
            graph.add_position(0.1 * index, place.translation(), np.full(3, 0.05))
        if index % 5 == 0:
            graph.fuse(None)
    found = graph.height
    assert found.factor == pytest.approx(1.04, abs=3 * found.sigma) and 0.003 < found.sigma < 0.015
    assert np.mean(lengths(graph)[-20:]) == pytest.approx(METRES, rel=0.02)  # 4 % are wrong


def test_earlier_lengths_are_smoothed():
    """What comes later holds for them, too: over seeds their errors become smaller."""
    online, smoothed = [], []
    for seed in range(20):
        made = steps(50, seed)
        online.append([step.length.mean - math.log(METRES) for step in made])
        smoothed.append(np.log(lengths(fed(made)) / METRES))
    online, smoothed = (np.sqrt(np.mean(np.square(errors))) for errors in (online, smoothed))
    assert 0.005 < smoothed < 0.92 * online  # measured 0.020 and 0.024


def test_the_published_path_is_not_bent_by_what_is_learnt_of_its_scale():
    """Of what scales differ by, the shape of a path has only what it has in no single scale."""
    bent: dict[str, list[float]] = {"continuous": [], "latest": []}
    truth = np.array([pose.translation() for pose in TRUE])
    for seed in range(12):
        for online, errors in bent.items():
            path = np.array([pose.mean.translation() for pose in published(seed, online)])
            scale = (path * truth).sum() / (path**2).sum()
            errors.append(float(np.sqrt(((scale * path - truth) ** 2).sum(axis=1).mean())))
    continuous, own = np.median(bent["continuous"]), np.median(bent["latest"])
    assert 0.05 < continuous < 0.6 * own  # metres on 75 m; measured 0.15 and 0.36


@pytest.mark.parametrize("seeds", [range(30), pytest.param(range(30, 150), marks=pytest.mark.slow, id="many")])
def test_what_is_published_is_as_far_off_as_it_says(seeds):
    """To what the graph is unsure of comes how far from its own pose the published one is."""
    last = [published(seed, "continuous")[-1] for seed in seeds]
    errors = np.array([gtsam.Pose3.Logmap(estimate.mean.between(TRUE[-1])) for estimate in last])
    values = nees(errors, np.array([estimate.covariance for estimate in last]))[0]
    assert 1 < values.mean() < 3  # lengths alone err, along a curve: of six numbers at most three; measured 2.0


def test_a_path_that_moves_by_more_than_a_step():
    """A position from outside moves it all at once, and new poses come before it is linearised again."""
    graph = Graph(CAMERA, GraphSettings(landmarks="none", odometry="essential"))
    graph.add_odometry(0.0, OdometryStep(0, GaussianPose.identity()))
    for index, step in enumerate(steps(70), 1):
        graph.add_odometry(0.1 * index, OdometryStep(index - 1, motion(step), step, step.length.variance))
        if index == 53:
            graph.add(position_factor(50, 1.1 * TRUE[50].translation(), 0.01))
        graph.fuse(None)
    assert lengths(graph)[50:] == pytest.approx(1.05 * METRES, rel=0.05)  # measured 1.03 to 1.07


def test_as_independent_ones_lengths_stay_as_they_are():
    made = steps(20)
    graph = fed(made, scale_model="independent")
    assert lengths(graph) == pytest.approx([step.length.metres for step in made], rel=1e-6)


def test_a_scale_in_common_does_not_average_out():
    """Nor do more frames make it better known."""
    made = [ScaleStep(LogScale(math.log(METRES), 0.05**2), LogScale(math.log(METRES), 0.05**2 if n == 0 else 1e-8))
            for n in range(20)]  # fmt: skip
    spread = {}
    for kind in ("chain", "independent"):
        graph = fed(made, scale_model=kind)
        pose = graph.pose(20)
        far = pose.mean.rotation().unrotate(pose.mean.translation())
        spread[kind] = math.sqrt(far @ pose.covariance[3:, 3:] @ far) / (far @ far)
    assert spread["chain"] == pytest.approx(0.05, rel=0.02)
    assert spread["independent"] < 0.02


@pytest.mark.parametrize("relative", [True, False])
def test_a_scale_that_nothing_measures_is_a_convention(relative):
    """Else, motions that contradict each other would shrink the path to a point, where they differ by no metres."""
    graph = Graph(CAMERA, GraphSettings(landmarks="none", kernel="none"), relative)
    graph.add_odometry(0.0, OdometryStep(0, GaussianPose.identity()))
    for number in range(12):
        unknown = number in (0, 6)  # odometry begins anew at the seventh
        predicted = LogScale(math.log(METRES), 1.0 if unknown else DRIFT**2)
        step = ScaleStep(LogScale(math.log(METRES), 1.0), predicted)
        graph.add_odometry(0.1 * (number + 1), OdometryStep(number, motion(step), step, 1.0))
    for first, last in ((0, 5), (7, 12)):
        aside = TRUE[first].between(TRUE[last]) * gtsam.Pose3(gtsam.Rot3(), np.array([0.3, 0.0, 0.0]))
        told = GaussianPose(aside, np.diag(np.repeat([0.1, 0.01], 3) ** 2))
        graph.add(motion_factor(first, last, told, graph.settings, length=False))
    graph.fuse(None)
    shares = lengths(graph) / METRES
    assert (0.85 < shares.min() < shares.max() < 1.05) if relative else shares.max() < 0.1


GUESSED = 8.0  # times as long as they are, motions before anything tells metres
TAKEN_OFF = 12  # frames until then


def takeoff() -> list[OdometryStep]:
    """Motions in a scale that is a guess, until it is measured; odometry takes it over at once."""
    made, true, guess = [], math.log(METRES), math.log(GUESSED * METRES)
    for number in range(40):
        predicted = LogScale(guess if number <= TAKEN_OFF else true, DRIFT**2 if number else 1.0)
        measured = LogScale(true, 0.05**2) if number >= TAKEN_OFF else None
        length = measured or LogScale(guess, 1.0)
        step = ScaleStep(length, predicted, measured)
        made.append(OdometryStep(number, motion(step), step, length.variance))
    return made


def test_what_was_flown_before_metres_were_known_has_them_afterwards():
    """However wrong the guess was: its lengths are not linear in the logarithm of the scale."""
    fusion = GraphFusion(CAMERA, GraphSettings(landmarks="none"), None)
    fusion.add_odometry(Frame(0, 0.0, None), OdometryStep(0, GaussianPose.identity()))
    poses = [fusion.pose]
    for index, step in enumerate(takeoff(), 1):
        fusion.add_odometry(Frame(index, 0.1 * index, None), step)
        if index == TAKEN_OFF + 2:  # visual SLAM waits for metres
            fusion.start(fusion.pose, NOTHING)
        elif index > TAKEN_OFF + 2 and index % 5 == 0:
            fusion.fuse(fusion.pose, fusion.pose, None)
        poses.append(fusion.pose)
    assert lengths(fusion.graph) == pytest.approx(METRES, rel=0.05)
    path = np.array([pose.translation() for pose in fusion.graph.smoothed().poses])
    truth = np.array([pose.translation() for pose in TRUE[: len(path)]])
    assert np.linalg.norm(path - truth, axis=1).max() < 0.05 * METRES * len(path)
    # From where metres are known, the online path is in metres, too, and goes on without a jump. That it is not where
    # it would be from its beginning, its covariance says.
    online = np.array([pose.mean.translation() for pose in poses])[TAKEN_OFF:]
    assert np.linalg.norm(np.diff(online, axis=0), axis=1) == pytest.approx(METRES, rel=0.05)
    away = online[-1] - truth[-1]
    assert np.linalg.norm(away) > METRES * TAKEN_OFF
    covariance = poses[-1].covariance[3:, 3:]
    error = poses[-1].mean.rotation().unrotate(away)
    assert error @ np.linalg.solve(covariance, error) < 3


def test_a_frame_that_is_located_has_the_scale_of_its_map():
    made = steps(10)
    graph = fed(made)
    small = GaussianPose(gtsam.Pose3(gtsam.Rot3(), np.array([0, 0, 0.3])), OWN)
    variance = made[-1].length.variance
    for number in range(3):
        graph.add_odometry(1.1 + 0.1 * number, OdometryStep(10, small.with_scale_variance(variance), None, variance))
    graph.fuse(None)
    assert not graph.solver.values().exists(scale_key(11))
    assert graph.solver.values().exists(scale_key(10))


def test_motions_from_the_first_frame_have_the_scale_of_its_map():
    """Whoever moves slowly has a first keyframe that lasts: what its map is not known by is not known anew."""
    made = steps(30)
    graph = Graph(CAMERA, GraphSettings(landmarks="none"))
    graph.add_odometry(0.0, OdometryStep(0, GaussianPose.identity()))
    first = made[0].length.variance
    frames = [OdometryStep(0, motion(made[0]), made[0], first), OdometryStep(0, motion(made[0]), None, first)]
    frames.append(OdometryStep(0, motion(made[1]), made[1], made[1].length.variance))
    frames += [OdometryStep(n + 1, motion(made[n]), made[n], made[n].length.variance) for n in range(2, 30)]
    for index, step in enumerate(frames, 1):
        graph.add_odometry(0.1 * index, step)
    graph.fuse(None)
    newest = scale_key(len(frames))
    assert graph.solver.values().atDouble(newest) == pytest.approx(0, abs=1e-5)
    assert graph.solver.covariance(newest)[0, 0] == pytest.approx(made[-1].length.variance, rel=1e-4)


def of_scale(variance: float) -> OdometryStep:
    """A motion from the first frame, in a scale that is known so well."""
    return OdometryStep(0, motion(made := ScaleStep(*2 * [LogScale(0.0, variance)])), made, variance)


def test_the_length_against_the_built_in_range():
    """With the scale as a constant, it is GTSAM's range between two poses, wherever these are."""
    update = PendingUpdate(Solver(GraphSettings()))
    chain = ScaleChain(update)
    variance = 0.03**2
    chain.extend(1, of_scale(variance))
    away = gtsam.Pose3.Expmap(np.array([0.3, -0.5, 0.8, 3.0, -2.0, 5.0]))
    assert chain.measure(0, 1, scale_key(1), GaussianPose(STEP, (1e-3 * METRES) ** 2 * np.eye(6)), away)
    sigma = math.hypot(1e-3, LENGTH_SIGMA) * METRES
    length = update.factors.at(update.factors.size() - 1)
    scaled = gtsam.Pose3(STEP.rotation(), 1.01 * STEP.translation())
    built_in = length_factor(0, 1, METRES, sigma)
    corrected = gtsam.Pose3.Expmap(np.array([0.1, -0.2, 0.1, 20.0, -10.0, 5.0])) * away
    for place in (away, corrected):
        for motion, scale in ((STEP, 0.0), (scaled, 0.01), (scaled, 0.0)):
            at = gtsam.Values()
            at.insert(pose_key(0), place)
            at.insert(pose_key(1), place * motion)
            at.insert(scale_key(1), scale)
            error = (np.linalg.norm(motion.translation()) - METRES * (1 + scale)) / sigma
            assert length.error(at) == pytest.approx(0.5 * error**2, rel=0.02, abs=0.01)
            if scale == 0:
                assert length.error(at) == pytest.approx(built_in.error(at), rel=0.02, abs=1e-9)


def test_the_length_of_a_motion_whose_direction_is_doubtful():
    """Where the right motion goes another way than odometry says, it is less long along that way."""
    doubt, squares, rng = 0.2, [], np.random.default_rng(0)
    directions = gtsam.Unit3(STEP.translation())
    own = GaussianPose(STEP, OWN).covariance.copy()
    basis = STEP.rotation().matrix().T @ directions.basis()
    own[3:, 3:] += (doubt * METRES) ** 2 * basis @ basis.T
    for _ in range(300):
        update = PendingUpdate(Solver(GraphSettings()))
        chain = ScaleChain(update)
        chain.extend(1, of_scale(1.0))
        assert chain.measure(0, 1, scale_key(1), GaussianPose(STEP, own), gtsam.Pose3())
        at = gtsam.Values()
        at.insert(pose_key(0), gtsam.Pose3())
        gone = METRES * directions.retract(doubt * rng.standard_normal(2)).point3()
        at.insert(pose_key(1), gtsam.Pose3(STEP.rotation(), gone))
        at.insert(scale_key(1), 0.0)
        squares.append(2 * update.factors.at(update.factors.size() - 1).error(at))
    assert 0.5 < np.mean(squares) < 1.5  # measured 1.0, and 7000 without


def test_the_drift_of_a_carried_scale_tells_the_calibration():
    """What the map and the ground say changes with it: with the right one, they agree."""
    k1, J_predicted, J_measured = 0.02, np.array([0.1, -1.0]), np.array([0.0, 0.5])
    true, made = LogScale(math.log(METRES), DRIFT**2), []
    for number in range(60):
        turns = 20 <= number < 40
        J = J_predicted if turns else np.zeros(2)
        carried = LogScale(true.mean - k1 * J[1], 1e-4**2 if number else 1.0)
        ground = LogScale(true.mean - k1 * J_measured[1], SETTINGS.plane_sigma**2)
        made.append(ScaleStep(true, carried, ground, 0.001**2, 0.5, J_predicted=J, J_measured=J_measured))
    graph = Graph(CAMERA, GraphSettings(distortion_sigma=0.05))
    graph.add_odometry(0.0, OdometryStep(0, GaussianPose.identity()))
    for number, step in enumerate(made):
        graph.add_odometry(0.1 * (number + 1), OdometryStep(number, motion(step), step, step.length.variance))
        if number % 5 == 4:
            graph.fuse(NOTHING)
    found = graph.calibration
    assert found is not None and found.k1 == pytest.approx(k1, abs=0.1 * k1) and found.k1_sigma < 0.1 * k1
    assert lengths(graph) == pytest.approx(METRES, rel=0.01)


def test_a_lag_leaves_scales_behind():
    whole, lagged = fed(steps(60)), fed(steps(60), lag=2.0)
    kept = [key for key in lagged.solver.values().keys() if gtsam.Symbol(key).chr() == ord("s")]  # noqa: SIM118
    assert len(kept) <= 22
    assert lengths(lagged)[-5:] == pytest.approx(lengths(whole)[-5:], rel=1e-3)


def test_the_files_have_the_lengths_that_were_found(tmp_path):
    graph = fed(steps(30))
    graph.smoothed()
    graph.write(tmp_path)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.deserialize((tmp_path / FACTORS).read_text())
    values.deserialize((tmp_path / VALUES).read_text())
    assert factors.error(values) == pytest.approx(0, abs=1e-3)
    motions, poses = gtsam.readG2o(str(tmp_path / G2O), True)
    assert motions.size() == 30
    assert motions.error(poses) == pytest.approx(0, abs=0.05)
    found = np.linalg.norm([motions.at(n).measured().translation() for n in range(30)], axis=1)
    assert found == pytest.approx(lengths(graph), rel=1e-4)


def test_a_camera_that_turns_has_less_of_the_error_of_its_scale_than_a_doubtful_map():
    turned = GaussianPose(gtsam.Pose3(gtsam.Rot3.Ry(0.1), np.array([0.07, 0.02, 0.01])), 1e-4 * np.eye(6))
    doubtful = MetricMap(MetricMap.empty().depths, 1.01)
    step = VoEstimate(1, 0, turned, Status.TRACKED, map=doubtful).step
    assert 0 < step.scale_variance == pytest.approx(1e-4 / np.sum(turned.mean.translation() ** 2))
    graph = Graph(CAMERA, GraphSettings(landmarks="none"))
    graph.add_odometry(0.0, OdometryStep(0, GaussianPose.identity()))
    graph.fuse(None)
    graph.add_odometry(0.1, step)
    fused = graph.fuse(None)
    assert fused.mean.equals(turned.mean, 1e-6)
    assert fused.covariance == pytest.approx(turned.covariance, rel=0.1, abs=1e-6)
    level = VoEstimate(1, 0, turned.with_scale_variance(1.01), Status.TRACKED, map=doubtful).step
    assert level.scale_variance == 1.01  # bit by bit, where there is room
