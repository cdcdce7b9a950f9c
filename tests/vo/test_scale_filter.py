"""The filter of the map's scale: optimal and consistent where its model holds."""

import math

import numpy as np
import pytest

from fvslam_graph.core.config import ScaleSettings
from fvslam_graph.core.gaussian_pose import LogScale
from fvslam_graph.vo.scale_filter import DRIFTS, GroundScale, ScaleFilter

SETTINGS = ScaleSettings(plane_sigma=0.02, bias_sigma=0.04, bias_correlation_keyframes=5.0, map_sigma=0.006)
START = 0.05  # deviation of the first scale
KEYFRAMES, RUNS = 60, 400


def following(scales: ScaleFilter, scale: LogScale, measured: GroundScale | None, added: float = 0.0) -> LogScale:
    """The scale after one more keyframe, of a map that says that nothing has changed."""
    scales.carry(scale.variance, added)
    return scales.update(scale.mean, measured)


def ground(mean: float, variance: float = 0.0, roughness: float = 1.0) -> GroundScale:
    return GroundScale(mean, variance, roughness)


def drive(
    seed: int, drift: float = 1.0, roughness: float = 1.0, silent=range(0), settings: ScaleSettings = SETTINGS
) -> tuple[float, float]:
    """Error of the scale and its variance after some keyframes of a world that is as SETTINGS say.

    Its map drifts by `drift` of the usual, and its ground is as rough as `roughness` says.
    """
    rng = np.random.default_rng(seed)
    scales = ScaleFilter(settings)
    decay = np.exp(-1 / SETTINGS.bias_correlation_keyframes)
    common = roughness * SETTINGS.bias_sigma * rng.standard_normal()
    scale = LogScale(START * rng.standard_normal(), START**2)
    for keyframe in range(KEYFRAMES):
        new = roughness * SETTINGS.bias_sigma * rng.standard_normal()
        common = decay * common + np.sqrt(1 - decay**2) * new
        error = scale.mean + drift * SETTINGS.map_sigma * rng.standard_normal()
        plane = ground(common + roughness * SETTINGS.plane_sigma * rng.standard_normal(), roughness=roughness)
        scale = following(scales, LogScale(error, scale.variance), None if keyframe in silent else plane)
    return scale.mean, scale.variance


@pytest.mark.parametrize(("roughness", "silent"), [(1.0, range(0)), (0.2, range(0)), (1.0, range(40, 50))])
def test_it_is_consistent(roughness, silent):
    """Over worlds whose maps drift as much or as little as it expects."""
    errors, variances = np.array([drive(seed, DRIFTS[seed % len(DRIFTS)], roughness, silent) for seed in range(RUNS)]).T
    assert np.mean(errors**2 / variances) == pytest.approx(1.0, abs=0.25)  # 400 runs: 0.07 is one deviation
    assert np.std(errors) < 0.03  # from 5 %


@pytest.mark.parametrize("drift", DRIFTS)
def test_whatever_the_drift_it_is_not_too_sure(drift):
    errors, variances = np.array([drive(seed, drift, 0.2) for seed in range(RUNS)]).T
    assert 0.5 < np.mean(errors**2 / variances) < 1.3


def test_ground_that_is_nearly_a_plane_tells_more():
    smooth, rough = (np.std([drive(seed, 0.1, share)[0] for seed in range(100)]) for share in (0.2, 1.0))
    assert smooth < rough / 3


def test_it_learns_how_much_the_map_drifts():
    """Where nothing is measured any more, the scale becomes as uncertain as the map has drifted before."""
    last = range(KEYFRAMES - 20, KEYFRAMES)
    steady, drifting = (np.mean([drive(seed, drift, 0.2, last)[1] for seed in range(50)]) for drift in (0.1, 1.6))
    assert steady < 0.3 * 20 * SETTINGS.map_sigma**2 < 20 * SETTINGS.map_sigma**2 < drifting


def test_independent_errors_would_be_too_sure():
    """Why there is a second state: the same world, and a filter that knows the same sizes, but not what lasts."""
    alone = SETTINGS.model_copy(update={"bias_sigma": 1e-6, "plane_sigma": 0.045})
    errors, variances = np.array([drive(seed, settings=alone) for seed in range(RUNS)]).T
    assert np.mean(errors**2 / variances) > 1.5


def test_without_a_shared_error_it_is_the_kalman_filter():
    scales = ScaleFilter(SETTINGS.model_copy(update={"bias_sigma": 1e-9, "map_sigma": 1e-9, "plane_sigma": 0.1}))
    scale = LogScale(1.0, 1 / 25)
    for count in range(1, 4):
        scale = following(scales, scale, ground(1.5))
        information = 25 + 100 * count
        assert scale.mean == pytest.approx((1.0 * 25 + 1.5 * 100 * count) / information, abs=1e-9)
        assert scale.variance == pytest.approx(1 / information, abs=1e-9)


def test_what_is_known_of_the_shared_error_outlasts_the_map():
    """A new map knows nothing of the scale, but the ground is still as wrong as it was."""
    exact = SETTINGS.model_copy(update={"plane_sigma": 0.01})
    scales = ScaleFilter(exact)
    for _ in range(30):
        scales.begin(1e-8)
        scales.update(0.0, ground(0.1))  # a certain map: the ground looks 10 % too large
    scales.begin(1.0)
    fresh = scales.update(0.0, ground(0.1))
    assert fresh.mean == pytest.approx(0.1 * (1 - np.exp(-1 / SETTINGS.bias_correlation_keyframes)), abs=0.01)
    naive = ScaleFilter(exact)
    naive.begin(1.0)
    assert naive.update(0.0, ground(0.1)).mean == pytest.approx(0.1, abs=0.01)


def test_nothing_measured_changes_nothing_but_by_the_drift():
    scale = following(ScaleFilter(SETTINGS), LogScale(0.3, 0.01), None)
    assert scale.mean == 0.3
    assert scale.variance == pytest.approx(0.01 + SETTINGS.map_sigma**2, rel=1e-4)


def test_what_all_measurements_err_by_is_not_averaged_out():
    """It changes nothing of how they are weighed, however long."""
    alone, common = ScaleFilter(SETTINGS), ScaleFilter(SETTINGS, 0.02)
    one = other = LogScale(0.0, 1.0)
    for measured in np.random.default_rng(0).normal(0.0, 0.05, 50):
        one, other = following(alone, one, ground(measured)), following(common, other, ground(measured))
    assert other.mean == pytest.approx(one.mean, rel=1e-2)
    assert other.variance == pytest.approx(one.variance + 0.02**2, rel=1e-2)


def test_a_map_that_has_become_doubtful_is_believed_less():
    scales = ScaleFilter(SETTINGS)
    for _ in range(20):
        scale = following(scales, LogScale(0.0, 1e-4), ground(0.0))
    assert following(scales, LogScale(scale.mean, scale.variance + 1), ground(0.2)).mean > 0.15


@pytest.mark.parametrize("off", [0.4, 0.7, 1.5, 4.0])
def test_a_map_that_is_wrong_is_given_up(off):
    """However certain it claims to be: what is measured again and again is right."""
    scales, scale = ScaleFilter(SETTINGS), LogScale(math.log(off), 1e-4)
    first = following(scales, scale, ground(0.0))
    assert first.mean == scale.mean and abs(first.mean) < 3 * np.sqrt(first.variance)  # it may be either
    second = following(scales, first, ground(0.0))
    assert abs(second.mean) < 3 * np.sqrt(second.variance) < 0.15


def test_a_measurement_that_is_wrong_leaves_the_map():
    scales, scale = ScaleFilter(SETTINGS), LogScale(0.0, 1e-4)
    for measured in (0.7, 0.0, 0.0, 0.0):
        scale = following(scales, scale, ground(measured))
    assert abs(scale.mean) < 0.01
    assert scale.variance < 0.05**2
