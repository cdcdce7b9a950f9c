"""What odometry, landmarks and other knowledge say, as factors."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.sensors import GRAVITY_SIGMA
from fvslam_graph.graph.calibration import CALIBRATION
from fvslam_graph.graph.factors import (
    LandmarkFactors,
    gravity_factor,
    height_factor,
    is_pose,
    landmark_key,
    length_factor,
    motion_factor,
    pose_factor,
    pose_key,
    position_factor,
    robust,
)

PLAIN = GraphSettings(kernel="none", shared_pixels="ignore")
CAMERA = Camera(640, 480, 450.0, 440.0, 319.5, 239.5)
MOTION = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.02, -0.05, 0.1), np.array([0.3, -0.1, 1.5]))


def metric(variance: float) -> GaussianPose:
    """A motion as two views and a scale of this log variance tell it."""
    direction = gtsam.Unit3(MOTION.translation())
    length, turn = np.linalg.norm(MOTION.translation()), MOTION.rotation().matrix().T
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = np.eye(3)
    jacobian[3:, 3:5] = length * turn @ direction.basis()
    jacobian[3:, 5] = length * turn @ direction.point3()
    rng = np.random.default_rng(0)
    mixing = 0.003 * rng.standard_normal((5, 5))
    measured = np.zeros((6, 6))
    measured[:5, :5], measured[5, 5] = mixing @ mixing.T, variance
    return GaussianPose(MOTION, jacobian @ measured @ jacobian.T)


def poses(first: gtsam.Pose3, second: gtsam.Pose3) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(pose_key(0), first)
    values.insert(pose_key(1), second)
    return values


def information(factors: list, values: gtsam.Values) -> np.ndarray:
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    return graph.linearize(values).hessian()[0]


def test_keys():
    assert is_pose(pose_key(12)) and not is_pose(landmark_key(12))
    assert gtsam.Symbol(landmark_key(7)).index() == 7


def test_five_degrees_of_freedom_and_a_length_are_six():
    variance = 0.02**2
    at = poses(gtsam.Pose3.Expmap(np.arange(6) / 7), gtsam.Pose3.Expmap(np.arange(6) / 7) * MOTION)
    six = [motion_factor(0, 1, metric(variance), PLAIN)]
    length = float(np.linalg.norm(MOTION.translation()))
    essential = motion_factor(0, 1, metric(variance), PLAIN.model_copy(update={"odometry": "essential"}))
    five_and_one = [essential, length_factor(0, 1, length, np.sqrt(variance) * length)]
    assert all(factor.error(at) == pytest.approx(0, abs=1e-12) for factor in six + five_and_one)
    a, b = information(six, at), information(five_and_one, at)
    assert b == pytest.approx(a, abs=1e-3 * np.abs(a).max())
    assert not np.allclose(a, b, rtol=1e-12)


def test_essential_says_nothing_of_the_length():
    essential = motion_factor(0, 1, metric(1e-4), PLAIN.model_copy(update={"odometry": "essential"}))
    longer = gtsam.Pose3(MOTION.rotation(), 3 * MOTION.translation())
    assert essential.error(poses(gtsam.Pose3(), longer)) == pytest.approx(0, abs=1e-12)
    aside = gtsam.Pose3(MOTION.rotation(), MOTION.translation() + np.array([0.1, 0, 0]))
    assert essential.error(poses(gtsam.Pose3(), aside)) > 1


def test_a_motion_whose_length_is_told_elsewhere():
    """It says nothing of it, and of all else what it says with its length."""
    factor = motion_factor(0, 1, metric(1e-4), PLAIN, length=False)
    longer = gtsam.Pose3(MOTION.rotation(), 3 * MOTION.translation())
    assert factor.error(poses(gtsam.Pose3(), longer)) == pytest.approx(0, abs=1e-12)
    at = poses(gtsam.Pose3(), MOTION)
    length = float(np.linalg.norm(MOTION.translation()))
    both = information([factor, length_factor(0, 1, length, 1e-2 * length)], at)
    whole = information([motion_factor(0, 1, metric(1e-4), PLAIN)], at)
    assert both == pytest.approx(whole, rel=1e-3, abs=1e-3 * np.abs(whole).max())


def test_a_motion_without_direction_has_six_degrees_of_freedom():
    still = GaussianPose(gtsam.Pose3(), 1e-6 * np.eye(6))
    factor = motion_factor(0, 1, still, GraphSettings(odometry="essential"))
    assert isinstance(factor, gtsam.BetweenFactorPose3)


def test_deflated_odometry_counts_for_less():
    at = poses(gtsam.Pose3(), MOTION)
    deflated = PLAIN.model_copy(update={"shared_pixels": "deflate", "deflation": 4.0})
    full, less = (information([motion_factor(0, 1, metric(1e-4), s)], at) for s in (PLAIN, deflated))
    assert less == pytest.approx(full / 4, rel=1e-3, abs=1e-3 * np.abs(full).max())


@pytest.mark.parametrize("kernel", ["huber", "cauchy", "geman_mcclure"])
def test_kernels_bound_what_an_outlier_costs(kernel):
    model = gtsam.noiseModel.Isotropic.Sigma(2, 1.0)
    settings = GraphSettings(kernel=kernel)
    factors = [gtsam.PriorFactorPoint2(0, np.zeros(2), noise) for noise in (model, robust(model, settings))]
    for at, bound in ((0.01, 1.0), (50.0, 0.2)):
        values = gtsam.Values()
        values.insert(0, np.array([at, 0.0]))
        plain, bounded = (factor.error(values) for factor in factors)
        assert 0 < bounded <= bound * plain * (1 + 1e-9)
        if at < 1:
            assert bounded == pytest.approx(plain, rel=1e-3)


@pytest.mark.parametrize("kernel", ["huber", "cauchy", "geman_mcclure"])
def test_kernels_weigh_honest_measurements_alike(kernel):
    """However many numbers they have: of one width for all, the kernel would take most of the weight of a motion."""
    rng = np.random.default_rng(0)
    weights = []
    for size in (1, 2, 6):
        estimator = robust(gtsam.noiseModel.Isotropic.Sigma(size, 1.0), GraphSettings(kernel=kernel)).robust()
        norms = np.linalg.norm(rng.standard_normal((2000, size)), axis=1)
        weights.append(np.mean([estimator.weight(norm) for norm in norms]))
    assert min(weights) > 0.6
    assert max(weights) - min(weights) < 0.15


def test_bearing_and_range_hold_the_covariance_of_the_point():
    point, rng = np.array([1.0, -0.5, 6.0]), np.random.default_rng(1)
    mixing = 0.05 * rng.standard_normal((3, 3))
    covariance = mixing @ mixing.T
    factor = LandmarkFactors(CAMERA, PLAIN).bearing_range(0, 3, point, covariance)
    values = gtsam.Values()
    values.insert(pose_key(0), gtsam.Pose3())
    values.insert(landmark_key(3), point)
    assert factor.error(values) == pytest.approx(0, abs=1e-12)
    graph = gtsam.NonlinearFactorGraph()
    graph.add(factor)
    graph.add(pose_factor(0, GaussianPose.identity()))
    there = gtsam.Marginals(graph, values).marginalCovariance(landmark_key(3))
    assert there == pytest.approx(covariance, abs=1e-6)


def test_projection_is_the_camera():
    point = np.array([1.0, -0.5, 6.0])
    pixel = CAMERA.project(point[None])[0]
    factors = LandmarkFactors(CAMERA, PLAIN)
    factor = factors.projection(0, 3, pixel + np.array([0.2, 0]), 0.2, 0)
    values = gtsam.Values()
    values.insert(CALIBRATION, factors.calibration.start)
    values.insert(pose_key(0), gtsam.Pose3())
    values.insert(landmark_key(3), point)
    assert factor.error(values) == pytest.approx(0.5)


def test_height_says_nothing_of_where_the_camera_is():
    down = np.array([0.0, 1.0, 0.0])
    factor = height_factor(0, 2.0, 0.1, down)
    for position, cost in (((0, -2, 0), 0.0), ((50, -2, 70), 0.0), ((0, -2.1, 0), 0.5)):
        values = gtsam.Values()
        values.insert(pose_key(0), gtsam.Pose3(gtsam.Rot3(), np.array(position, float)))
        assert factor.error(values) == pytest.approx(cost, abs=1e-3)


def test_positions_of_satellites():
    values = gtsam.Values()
    values.insert(pose_key(4), gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 2.0, 3.5])))
    assert position_factor(4, np.array([1.0, 2.0, 3.0]), 0.5).error(values) == pytest.approx(0.5)


def test_gravity_holds_roll_and_pitch_alone():
    down = np.array([0.0, 1.0, 0.0])
    tilt = 0.01
    for turn, cost in (((0, 0.7, 0), 0.0), ((0, 0, 0), 0.0), ((tilt, 0, 0), 1.0), ((0, 0, tilt), 1.0)):
        values = gtsam.Values()
        values.insert(pose_key(2), gtsam.Pose3(gtsam.Rot3.Expmap(np.array(turn, float)), np.ones(3)))
        expected = cost * (tilt / GRAVITY_SIGMA / np.sqrt(2)) ** 2 / 2
        assert gravity_factor(2, down, down).error(values) == pytest.approx(expected, rel=1e-3, abs=1e-9)
