"""What the camera adds to a rendered image."""

import numpy as np
import pytest

from fvslam_graph.simulation.worlds.effects import Effects

STAMPS = np.arange(100) / 10
GREY = np.full((60, 80), 100, np.float32)


def effects(noise: float = 0, blur: float = 0, exposure: float = 0, drop: float = 0, seed: int = 0) -> Effects:
    return Effects(STAMPS, 0.1, noise, blur, exposure, drop, seed)


def test_without_effects_the_image_is_what_the_world_looks_like_at_the_stamp() -> None:
    times = []
    image = effects().apply(7, lambda time: times.append(time) or GREY + 0.4)
    assert times == [STAMPS[7]]
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, 100)


def test_values_outside_of_the_range_are_clipped() -> None:
    image = effects().apply(0, lambda time: np.array([[-30, 300]], np.float32))
    np.testing.assert_array_equal(image, [[0, 255]])


def test_noise_is_gaussian_independent_and_without_bias() -> None:
    noisy = effects(noise=3)
    errors = np.array([noisy.apply(index, lambda time: GREY).ravel() - 100.0 for index in (4, 5)])
    assert errors.std() == pytest.approx(3, rel=0.05)
    assert abs(errors.mean()) < 0.1
    assert abs(np.corrcoef(errors)[0, 1]) < 0.05


def test_blur_averages_over_the_exposure_around_the_stamp() -> None:
    times = []
    image = effects(blur=0.5).apply(20, lambda time: times.append(time) or GREY * np.float32(time > STAMPS[20]))
    assert np.ptp(times) == pytest.approx(0.05, rel=0.15)
    assert np.mean(times) == pytest.approx(STAMPS[20])
    assert image[0, 0] == pytest.approx(50, abs=7)


def test_exposure_drifts_and_jumps() -> None:
    lively = effects(exposure=0.2)
    brightness = np.array([lively.apply(index, lambda time: GREY)[0, 0] for index in range(100)], float)
    assert 1.2 < brightness.max() / brightness.min() < 2
    steps = np.abs(np.diff(brightness))
    assert np.median(steps) < 4
    assert steps[[46, 93]].max() > 2 * np.median(steps)  # at 4.7 s and 9.4 s
    other = effects(exposure=0.2, seed=1)
    assert any(other.apply(index, lambda time: GREY)[0, 0] != brightness[index] for index in (0, 50))


@pytest.mark.parametrize(("drop", "count"), [(0.0, 0), (0.1, 10), (0.999, 99)])
def test_the_share_of_lost_images_is_exact_and_the_first_is_kept(drop: float, count: int) -> None:
    lost = effects(drop=drop).dropped()
    assert len(np.unique(lost)) == count
    assert 0 not in lost
