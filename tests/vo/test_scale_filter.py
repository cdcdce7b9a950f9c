"""The filter of the map's scale: optimal and consistent where its model holds."""

import numpy as np
import pytest

from fvslam_graph.core.config import ScaleSettings
from fvslam_graph.core.gaussian_pose import LogScale
from fvslam_graph.vo.scale_filter import ScaleFilter

SETTINGS = ScaleSettings(plane_sigma=0.02, bias_sigma=0.04, bias_correlation_keyframes=5.0, map_sigma=0.006)
START = 0.05  # deviation of the first scale
KEYFRAMES, RUNS = 60, 400


def drive(settings: ScaleSettings, seed: int, silent=range(0)) -> tuple[float, float]:
    """Error of the scale and its variance after some keyframes of a world that is as SETTINGS say."""
    rng = np.random.default_rng(seed)
    scales = ScaleFilter(settings)
    decay = np.exp(-1 / SETTINGS.bias_correlation_keyframes)
    common = SETTINGS.bias_sigma * rng.standard_normal()
    error, variance = START * rng.standard_normal(), START**2
    for keyframe in range(KEYFRAMES):
        common = decay * common + np.sqrt(1 - decay**2) * SETTINGS.bias_sigma * rng.standard_normal()
        error += SETTINGS.map_sigma * rng.standard_normal()
        variance += SETTINGS.map_sigma**2
        plane = LogScale(common + SETTINGS.plane_sigma * rng.standard_normal(), SETTINGS.plane_sigma**2)
        scale = scales.update(LogScale(error, variance), None if keyframe in silent else plane)
        error, variance = scale.mean, scale.variance
    return error, variance


@pytest.mark.parametrize("silent", [range(0), range(40, 50)])
def test_it_is_consistent(silent):
    errors, variances = np.array([drive(SETTINGS, seed, silent) for seed in range(RUNS)]).T
    assert np.mean(errors**2 / variances) == pytest.approx(1.0, abs=0.2)  # 400 runs: 0.07 is one deviation
    assert np.std(errors) < 0.03  # from 5 %


def test_independent_errors_would_be_too_sure():
    """Why there is a second state: the same world, and a filter that knows the same sizes, but not what lasts."""
    alone = SETTINGS.model_copy(update={"bias_sigma": 1e-6, "plane_sigma": 0.045})
    errors, variances = np.array([drive(alone, seed) for seed in range(RUNS)]).T
    assert np.mean(errors**2 / variances) > 1.5


def test_without_a_shared_error_it_is_the_kalman_filter():
    scales = ScaleFilter(SETTINGS.model_copy(update={"bias_sigma": 1e-9}))
    scale, measured = LogScale(1.0, 1 / 25), LogScale(1.5, 1 / 100)
    for count in range(1, 4):
        scale = scales.update(scale, measured)
        information = 25 + 100 * count
        assert scale.mean == pytest.approx((1.0 * 25 + 1.5 * 100 * count) / information, abs=1e-9)
        assert scale.variance == pytest.approx(1 / information, abs=1e-9)


def test_what_is_known_of_the_shared_error_outlasts_the_map():
    """A new map knows nothing of the scale, but the ground is still as wrong as it was."""
    scales = ScaleFilter(SETTINGS)
    for _ in range(30):
        scales.update(LogScale(0.0, 1e-8), LogScale(0.1, 1e-4))  # a certain map: the ground looks 10 % too large
    scales.forget()
    fresh = scales.update(LogScale(0.0, 1.0), LogScale(0.1, 1e-4))
    assert fresh.mean == pytest.approx(0.1 * (1 - np.exp(-1 / SETTINGS.bias_correlation_keyframes)), abs=0.01)
    naive = ScaleFilter(SETTINGS).update(LogScale(0.0, 1.0), LogScale(0.1, 1e-4))
    assert naive.mean == pytest.approx(0.1, abs=0.01)


def test_nothing_measured_changes_nothing():
    predicted = LogScale(0.3, 0.01)
    assert ScaleFilter(SETTINGS).update(predicted, None) == predicted


@pytest.mark.parametrize("off", [0.4, 0.7, 1.5, 4.0])
def test_a_map_that_is_wrong_is_given_up(off):
    """However certain it claims to be: what is measured again and again is right."""
    scales, scale = ScaleFilter(SETTINGS), LogScale(np.log(off), 1e-4)
    plane = LogScale(0.0, SETTINGS.plane_sigma**2)
    first = scales.update(scale, plane)
    assert first.mean == scale.mean and abs(first.mean) < 3 * np.sqrt(first.variance)  # it may be either
    second = scales.update(first, plane)
    assert abs(second.mean) < 3 * np.sqrt(second.variance) < 0.15


def test_a_measurement_that_is_wrong_leaves_the_map():
    scales, scale = ScaleFilter(SETTINGS), LogScale(0.0, 1e-4)
    for measured in (0.7, 0.0, 0.0, 0.0):
        scale = scales.update(scale, LogScale(measured, SETTINGS.plane_sigma**2))
    assert abs(scale.mean) < 0.01
    assert scale.variance < 0.05**2
