"""The camera's calibration as a variable of the graph."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from fvslam_graph.camera import Camera, Distortion
from fvslam_graph.config import GraphSettings
from fvslam_graph.estimates import GaussianPose, OdometryStep
from fvslam_graph.fusion.calibration import CALIBRATION, SelfCalibration, is_camera
from fvslam_graph.fusion.factors import (
    LandmarkFactors,
    calibrated_motion_factor,
    landmark_key,
    motion_factor,
    pose_key,
)
from fvslam_graph.sequences.points import simulate_drive

CAMERA = Camera(640, 480, 450.0, 440.0, 319.5, 239.5)
ROUGH = {"focal_sigma": 0.02, "distortion_sigma": 0.02}
VALUE = gtsam.Cal3Bundler(460.0, 0.02, 0.001, CAMERA.cx, CAMERA.cy)


def test_the_factor_sees_what_the_camera_sees():
    settings = GraphSettings(kernel="none", shared_noise=0.0)
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
    assert np.median(np.abs(off), axis=0).max() < 1.5  # standard deviations
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


@pytest.mark.parametrize("length", [True, False])
def test_a_motion_changes_with_the_calibration_as_odometry_says(length):
    """With that of the file it is the built-in factor; with another one, the motion that odometry would have made."""
    rng, settings = np.random.default_rng(3), GraphSettings()
    motion = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.02, -0.05, 0.1), np.array([0.3, -0.1, 1.5]))
    root = 0.01 * rng.standard_normal((6, 6))
    step = OdometryStep(4, GaussianPose(motion, root @ root.T), by_calibration=0.1 * rng.standard_normal((6, 2)))
    calibration = SelfCalibration(CAMERA, settings)
    own = calibrated_motion_factor(5, step, settings, calibration, length)
    built_in = motion_factor(4, 5, step.prev_T_cur, settings, length)
    values = gtsam.Values()
    values.insert(pose_key(4), gtsam.Pose3.Expmap(rng.standard_normal(6)))
    values.insert(pose_key(5), values.atPose3(pose_key(4)).compose(motion).retract(0.02 * rng.standard_normal(6)))
    values.insert(CALIBRATION, calibration.start)
    assert own.error(values) == pytest.approx(built_in.error(values))
    at, built = own.linearize(values), built_in.linearize(values)
    assert at.jacobian()[0][:, :12] == pytest.approx(built.jacobian()[0])
    assert at.jacobian()[1] == pytest.approx(built.jacobian()[1])

    values.update(CALIBRATION, VALUE)
    moved = motion.retract(step.by_calibration @ [VALUE.fx() / CAMERA.fx - 1, VALUE.k1()])
    values.update(pose_key(5), values.atPose3(pose_key(4)).compose(moved))
    assert own.error(values) == pytest.approx(0, abs=1e-12)


def test_the_derivative_in_the_calibration_by_finite_differences():
    settings, step = GraphSettings(kernel="none"), 1e-6
    motion = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.02, -0.05, 0.1), np.array([0.3, -0.1, 1.5]))
    by_calibration = np.random.default_rng(4).standard_normal((6, 2))
    odometry = OdometryStep(0, GaussianPose(motion, 1e-4 * np.eye(6)), by_calibration=by_calibration)
    factor = calibrated_motion_factor(1, odometry, settings, SelfCalibration(CAMERA, settings))
    values = gtsam.Values()
    values.insert(pose_key(0), gtsam.Pose3())
    values.insert(pose_key(1), motion)
    values.insert(CALIBRATION, VALUE)
    jacobian = factor.linearize(values).jacobian()[0][:, 12:]

    def whitened(change: np.ndarray) -> np.ndarray:
        values.update(CALIBRATION, VALUE.retract(change))
        return np.asarray(factor.whitenedError(values))

    numeric = [(whitened(step * axis) - whitened(-step * axis)) / (2 * step) for axis in np.eye(3)]
    assert jacobian == pytest.approx(np.column_stack(numeric), rel=1e-4, abs=1e-4)
