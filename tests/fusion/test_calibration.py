"""The camera's calibration as a variable of the graph."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from fvslam_graph.camera import Camera, Distortion
from fvslam_graph.config import GraphSettings
from fvslam_graph.fusion.calibration import CALIBRATION, SelfCalibration, is_camera
from fvslam_graph.fusion.factors import LandmarkFactors, landmark_key, pose_key
from fvslam_graph.sequences.points import simulate_drive

CAMERA = Camera(640, 480, 450.0, 440.0, 319.5, 239.5)
PRIOR = GraphSettings()
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
    """As far off as two and more deviations of the prior; then the path is as good as with the right one."""
    off, errors = [], []
    for seed in range(5):
        scene = simulate_drive(frames=61, seed=seed, noise=0.3, landmarks=9000)
        fx, fy = focal * scene.camera.fx, focal * scene.camera.fy
        true = replace(scene.camera, fx=fx, fy=fy, distortion=Distortion.RADTAN, coefficients=(k1, 0.0, 0.0, 0.0))
        made = fed(scene=replace(scene, camera=true), camera=scene.camera, seed=seed)
        found = made.graph.calibration
        off.append([(found.focal_length - fx) / found.focal_sigma, (found.k1 - k1) / found.k1_sigma])
        errors.append((made.error(), fed(scene=replace(scene, camera=true), camera=true, seed=seed).error()))
        assert found.focal_sigma < 0.7 * PRIOR.focal_sigma * fx and found.k1_sigma < 0.7 * PRIOR.distortion_sigma
    assert np.median(np.abs(off), axis=0).max() < 1.5  # standard deviations
    assert np.abs(off).max() < 4
    found, known = np.mean(errors, axis=0)
    assert found < 1.2 * known


def test_what_is_known_exactly_stays(fed):
    made = fed(focal_sigma=0.0, distortion_sigma=0.0)
    assert made.graph.calibration.focal_length == pytest.approx(made.scene.camera.fx, abs=1e-4)
    assert abs(made.graph.calibration.k1) < 1e-4
    assert fed(landmarks="none").graph.calibration is None


@pytest.mark.parametrize(("focal", "k1"), [(-450.0, 0.0), (np.nan, 0.0), (450.0, 1e9), (450.0, np.nan)])
def test_a_step_too_far_makes_no_camera(focal, k1):
    assert is_camera(VALUE)
    assert not is_camera(gtsam.Cal3Bundler(focal, k1, 0.0, 320.0, 240.0))
