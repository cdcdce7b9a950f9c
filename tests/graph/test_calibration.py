"""The camera's calibration as a variable of the graph."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera, Distortion
from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.vo_estimate import OdometryStep
from fvslam_graph.graph.calibration import CALIBRATION, SelfCalibration, is_camera
from fvslam_graph.graph.factors import (
    LandmarkFactors,
    calibrated_motion_factors,
    filed_key,
    landmark_key,
    motion_factor,
    pose_key,
)
from fvslam_graph.simulation.points import simulate_drive

CAMERA = Camera(640, 480, 450.0, 440.0, 319.5, 239.5)
ROUGH = {"focal_sigma": 0.02, "distortion_sigma": 0.02}
VALUE = gtsam.Cal3Bundler(460.0, 0.02, 0.001, CAMERA.cx, CAMERA.cy)


def test_the_factor_sees_what_the_camera_sees():
    settings = GraphSettings(kernel="none", common_noise=0.0)
    factors, points = (
        LandmarkFactors(CAMERA, settings),
        np.random.default_rng(0).uniform((-3, -2, 4), (3, 2, 8), (20, 3)),
    )
    pixels = SelfCalibration(CAMERA, settings).camera(VALUE).project(points)
    values = gtsam.Values()
    values.insert(CALIBRATION, VALUE)
    values.insert(pose_key(0), gtsam.Pose3())
    for number, (point, pixel) in enumerate(zip(points, pixels, strict=True)):
        values.insert(landmark_key(number), point)
        assert factors.projection(0, number, pixel, 0.2, 0).error(values) == pytest.approx(0, abs=1e-12)


def test_a_k1_that_leaves_the_file_leaves_the_focal_length_there():
    """With one kernel for both, either would free the other: in a turn, they make a scale drift alike."""
    calibration, graph = SelfCalibration(CAMERA, GraphSettings()), gtsam.NonlinearFactorGraph()
    for prior in calibration.priors():
        graph.add(prior)
    at = gtsam.Values()
    at.insert(CALIBRATION, gtsam.Cal3Bundler(CAMERA.fx, VALUE.k1(), 0.0, CAMERA.cx, CAMERA.cy))
    information = graph.linearize(at).hessian()[0]
    held, freed = GraphSettings().focal_sigma * CAMERA.fx, GraphSettings().distortion_sigma
    assert information[0, 0] == pytest.approx(held**-2)
    assert information[1, 1] < 0.01 * freed**-2


@pytest.mark.parametrize(("focal", "k1"), [(1.0, 0.0), (1.03, 0.0), (1.0, 0.02), (0.97, 0.02), (1.02, -0.02)])
def test_a_wrong_calibration_is_found(fed, focal, k1):
    """By landmarks, where motions are known apart from it; the path is as good as with the right one."""
    off, errors = [], []
    for seed in range(5):
        scene = simulate_drive(frames=61, seed=seed, noise=0.3, landmarks=9000)
        fx, fy = focal * scene.camera.fx, focal * scene.camera.fy
        true = replace(scene.camera, fx=fx, fy=fy, distortion=Distortion.RADTAN, coefficients=(k1, 0.0, 0.0, 0.0))
        made = fed(scene=replace(scene, camera=true), camera=scene.camera, seed=seed, **ROUGH)
        found = made.graph.calibration
        off.append([(found.focal_length - fx) / found.focal_sigma, (found.k1 - k1) / found.k1_sigma])
        errors.append((made.error(), fed(scene=replace(scene, camera=true), camera=true, seed=seed).error()))
        assert found.focal_sigma < 0.8 * ROUGH["focal_sigma"] * fx and found.k1_sigma < 0.8 * ROUGH["distortion_sigma"]
    assert np.abs(off).mean() < 1.5  # standard deviations, of both numbers; 0.8 is expected
    assert np.abs(off).max() < 4
    found, known = np.mean(errors, axis=0)
    assert found < 1.5 * known  # measured up to 1.37


def test_what_is_known_exactly_stays(fed):
    made = fed(focal_sigma=0.0, distortion_sigma=0.0)
    assert made.graph.calibration.focal_length == pytest.approx(made.scene.camera.fx, abs=1e-4)
    assert abs(made.graph.calibration.k1) < 1e-4
    assert fed(landmarks="none").graph.calibration is None


@pytest.mark.parametrize(("focal", "k1"), [(-450.0, 0.0), (np.nan, 0.0), (450.0, 1e9), (450.0, np.nan)])
def test_a_step_too_far_makes_no_camera(focal, k1):
    assert is_camera(VALUE)
    assert not is_camera(gtsam.Cal3Bundler(focal, k1, 0.0, 320.0, 240.0))


def step_of(rng: np.random.Generator) -> OdometryStep:
    """A motion to frame 5 that changes with the calibration."""
    root = np.diag(np.repeat([0.003, 0.01], 3)) + 0.0005 * rng.standard_normal((6, 6))
    motion = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.02, -0.05, 0.1), np.array([0.3, -0.1, 1.5]))
    return OdometryStep(4, GaussianPose(motion, root @ root.T), J_calibration=0.1 * rng.standard_normal((6, 2)))


@pytest.mark.parametrize("length", [True, False])
def test_with_the_calibration_of_the_file_a_motion_is_the_built_in_factor(length):
    rng, settings = np.random.default_rng(3), GraphSettings(kernel="none")
    step, calibration = step_of(rng), SelfCalibration(CAMERA, settings)
    first = gtsam.Pose3.Expmap(rng.standard_normal(6))
    second = first.compose(step.prev_T_cur.mean)
    values, covariances = gtsam.Values(), []
    for key, value in ((pose_key(4), first), (pose_key(5), second)):
        values.insert(key, value)
    for own in (False, True):
        graph = gtsam.NonlinearFactorGraph()
        for key in (pose_key(4), pose_key(5)):  # of a motion without a length, the second does not tell all
            graph.add(gtsam.PriorFactorPose3(key, values.atPose3(key), gtsam.noiseModel.Isotropic.Sigma(6, 0.02)))
        if own:
            values.insert(filed_key(5), second)
            values.insert(CALIBRATION, calibration.start)
            exact = gtsam.noiseModel.Isotropic.Sigma(3, 1e-4)
            graph.add(gtsam.PriorFactorCal3Bundler(CALIBRATION, calibration.start, exact))
            for factor in calibrated_motion_factors(5, step, settings, calibration, second, length):
                graph.add(factor)
        else:
            graph.add(motion_factor(4, 5, step.prev_T_cur, settings, length))
        covariances.append(gtsam.Marginals(graph, values).marginalCovariance(pose_key(5)))
    assert covariances[1] == pytest.approx(covariances[0], rel=3e-3, abs=1e-7)


def test_with_another_calibration_it_is_the_motion_that_odometry_would_have_made():
    rng, settings = np.random.default_rng(4), GraphSettings()
    step, calibration = step_of(rng), SelfCalibration(CAMERA, settings)
    start = step.prev_T_cur.mean
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for factor in calibrated_motion_factors(5, step, settings, calibration, start):
        graph.add(factor)
    graph.add(gtsam.PriorFactorPose3(pose_key(4), gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)))
    graph.add(gtsam.PriorFactorCal3Bundler(CALIBRATION, VALUE, gtsam.noiseModel.Isotropic.Sigma(3, 1e-4)))
    for key, value in ((pose_key(4), gtsam.Pose3()), (pose_key(5), start), (filed_key(5), start)):
        values.insert(key, value)
    values.insert(CALIBRATION, calibration.start)
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    moved = start.retract(step.J_calibration @ [VALUE.fx() / CAMERA.fx - 1, VALUE.k1()])
    assert graph.error(found) == pytest.approx(0, abs=1e-6)
    assert found.atPose3(pose_key(5)).equals(moved, 1e-4)
    assert found.atPose3(filed_key(5)).equals(start, 1e-5)
