"""A calibration that is grossly wrong is found from the images, one that is right is left alone."""

from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.core.camera import Recalibration
from fvslam_graph.core.config import load_config
from fvslam_graph.core.vo_estimate import CalibrationEvidence
from fvslam_graph.estimator import estimate
from fvslam_graph.testing import rendered
from fvslam_graph.vo.motion_fit import RELAXED
from fvslam_graph.vo.online_calibration import OnlineCalibration


def lens(camera, log_focal, k1):
    """The camera as it is, where `camera` is what its file says."""
    return camera.corrected(np.array([log_focal, k1, 0, 0, 0, 0, 0]))


def test_the_gradient_is_that_of_the_likelihood(camera, pair):
    """Without noise, evidence leads to the truth in one step, as far as it is linear; where all is right, nowhere.

    Weights are one then, and tell nothing too much.
    """
    for log_focal, k1 in ((0.0, 0.0), (0.0, 0.004), (0.004, 0.0), (-0.003, -0.003)):
        pairs = [pair(lens(camera, log_focal, k1), 0, seed) for seed in range(6)]
        information = RELAXED * sum(evidence.information for evidence in pairs)[:2, :2]
        found = np.linalg.solve(information, sum(evidence.gradient for evidence in pairs)[:2])
        assert found == pytest.approx([log_focal, k1], rel=0.2, abs=0.001)  # measured 12 %, 0.0006


def test_corrected_pixels_are_those_of_the_camera_of_the_file(camera):
    true, pixels = lens(camera, 0.02, 0.03), np.random.default_rng(0).uniform(0, 480, (50, 2))
    recalibration = Recalibration(camera, true)
    assert recalibration.corrected(pixels) == pytest.approx(camera.project(true.rays(pixels)), abs=1e-9)
    assert recalibration.filed(recalibration.corrected(pixels)) == pytest.approx(pixels, abs=1e-6)


@pytest.mark.parametrize(("log_focal", "k1"), [(0.0, 0.03), (-0.02, -0.03)])
def test_it_comes_nearer_to_the_truth(camera, pair, log_focal, k1):
    true, online, corrections = lens(camera, log_focal, k1), OnlineCalibration(camera), []
    for seed in range(40):
        # What is left to see after the images were rectified with what is known.
        left = replace(
            true,
            fx=true.fx * np.exp(-online.applied[0]),
            fy=true.fy * np.exp(-online.applied[0]),
            coefficients=(k1 - online.applied[1], 0, 0, 0),
        )
        correction = online.add(pair(left, 0.2, seed))
        corrections += [] if correction is None else [correction]
    errors = [np.abs(correction.mean - (log_focal, k1)) for correction in corrections]
    assert len(corrections) >= 3 and errors[-1][1] < 0.1 * abs(k1)  # measured 0.03
    assert np.all(errors[-1] < 4 * corrections[-1].sigmas)
    assert np.all(corrections[-1].sigmas < corrections[0].sigmas)


@pytest.mark.parametrize("seed", [0, 100])
def test_a_calibration_that_is_right_stays(camera, pair, seed):
    online = OnlineCalibration(camera)
    assert not any(online.add(pair(lens(camera, 0, 0), 0.3, seed + number)) for number in range(25))
    assert np.array_equal(online.applied, np.zeros(2))


def test_what_only_looks_like_a_wrong_focal_length_corrects_nothing(camera, pair):
    """A principal point that is off: taken alone, the focal length would be wrong by more than ten deviations."""
    online, true = OnlineCalibration(camera), replace(camera, cx=camera.cx + 8)
    assert not any(online.add(pair(true, 0.3, seed)) for seed in range(25))


def test_what_was_corrected_stays_when_later_pairs_are_not_certain(camera, pair):
    """The pairs before a correction do not count after it, and the first ones since tell less."""
    online, true = OnlineCalibration(camera), lens(camera, 0.0, 0.03)
    assert any(online.add(pair(true, 0.2, seed)) for seed in range(25))  # until one corrects
    since = OnlineCalibration(camera)
    for number in range(8):
        information = np.diag([1e4, 3e3, 1.0, 1.0, 1.0, 1.0, 1.0])  # k1 within 0.008 by five of them
        left = np.array([0.0, 0.03 - online.applied[1], 0, 0, 0, 0, 0])
        online.add(CalibrationEvidence(information, information @ left))
        since.add(CalibrationEvidence(information, information @ np.array([0.0, 0.03, 0, 0, 0, 0, 0])))
        assert online.applied[1] == pytest.approx(0.03, abs=0.01), number
    assert not since.applied.any()  # by themselves, they correct nothing


def test_what_is_gross_at_one_look_only_is_not_taken_out(camera):
    """It has to be so at the next look, too: five pairs, then seven."""
    information = np.diag([1e4, 1.5e5, 1.0, 1.0, 1.0, 1.0, 1.0])
    gross, less = (
        CalibrationEvidence(information, information @ np.array([0, k1, 0, 0, 0, 0, 0])) for k1 in (0.008, 0)
    )
    online = OnlineCalibration(camera)
    assert not any(online.add(evidence) for evidence in [gross] * 5 + [less] * 2 + [gross] * 2)
    assert online.left[1] > 0.004 and not online.applied.any()
    steady = OnlineCalibration(camera)
    corrections = [steady.add(gross) for _ in range(7)]
    assert not any(corrections[:6]) and corrections[6].mean[1] == pytest.approx(0.008, rel=0.05)


def test_what_is_certain_and_small_is_left_to_the_scale(camera):
    online = OnlineCalibration(camera)
    k1, information = 0.005, np.diag([1e4, 1.5e5, 1.0, 1.0, 1.0, 1.0, 1.0])  # within 0.0026 by each pair
    error = np.array([0.0, k1, 0, 0, 0, 0, 0])
    assert not any(online.add(CalibrationEvidence(information, information @ error)) for _ in range(2))
    assert not online.left.any()
    assert not any(online.add(CalibrationEvidence(information, information @ error)) for _ in range(18))
    assert online.left == pytest.approx([0.0, k1], rel=0.05) and not online.applied.any()


def test_it_can_be_switched_off(camera, pair):
    online = OnlineCalibration(camera, enabled=False)
    assert not any(online.add(pair(lens(camera, 0, 0.05), 0, seed)) for seed in range(10))


@pytest.fixture(scope="module")
def bent():
    """A flight through a lens whose distortion its file does not know."""
    flight = rendered("uav", frames=60)
    return flight.recalibrated(lens(flight.camera, 0.0, -0.03))


@pytest.mark.parametrize("mode", ["average", "graph"])
def test_a_flight_with_a_wrong_calibration(bent, mode, caplog):
    errors = []
    for calibrate in ("true", "false"):
        config = load_config(settings=[f"mode={mode}", f"vo.calibrate={calibrate}"])
        results = list(estimate(bent, config))
        error = bent.ground_truth.poses[-1].between(results[-1].pose.mean)
        errors.append(np.linalg.norm(error.translation()))
    assert errors[0] < 0.8 * errors[1]  # measured 0.73 (0.68 to 0.77 with other seeds): the first motions stay wrong
    assert len(caplog.messages) == 1 and "do not fit their calibration" in caplog.messages[0]
