"""Brightness relative to the surroundings, and tracks that no change of brightness moves."""

import numpy as np
import pytest

from fvslam_graph.core.config import FeatureSettings
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.features.brightness import DARK, MIDDLE, relative_brightness
from fvslam_graph.features.klt import KltTracker

SHIFT = (2.4, -1.3)


def brighter(image, gain, offset=0.0):
    return np.clip(np.rint(gain * image + offset), 0, 255).astype(np.uint8)


def test_a_gain_cancels(texture):
    image = texture()
    same, half = relative_brightness(image, 88), relative_brightness(brighter(image, 0.5), 88)
    assert same.mean() == pytest.approx(MIDDLE * 128 / (128 + DARK), abs=5)
    assert np.corrcoef(same.ravel(), half.ravel())[0, 1] > 0.999
    assert half.std() == pytest.approx(same.std(), rel=0.15)  # a little less: DARK counts for more in the dark


def test_noise_in_the_dark_is_no_texture():
    dark = np.random.default_rng(0).integers(0, 3, (120, 160)).astype(np.uint8)
    assert relative_brightness(dark, 88).std() < MIDDLE / DARK  # of noise with a deviation of 0.8
    assert not relative_brightness(np.zeros_like(dark), 88).any()


@pytest.mark.parametrize("shape", [(1, 1), (5, 7), (9, 400)])
def test_tiny_images(shape):
    assert relative_brightness(np.full(shape, 90, np.uint8), 88).shape == shape


def followed(texture, change) -> tuple[int, float]:
    """How many tracks there are after a shift and a change of brightness, and their mean error, pixels."""
    tracker = KltTracker(FeatureSettings())
    tracker.set_keyframe(texture(noise=1.0), Tracks.none())
    tracks = tracker.track(change(texture(SHIFT, noise=1.0)))
    return len(tracks), float(np.linalg.norm(tracks.current - tracks.keyframe - SHIFT, axis=1).mean())


@pytest.mark.parametrize(
    ("change", "bound"),  # mean errors by grey levels: 6.0, 0.65, 0.33 and 2.2 pixels
    [
        (lambda image: brighter(image, 0.7), 0.15),  # measured 0.08
        (lambda image: brighter(image, 0.84, 45.0), 0.3),  # measured 0.16: an offset does not cancel
        (lambda image: brighter(image, 1 + 0.2 * np.sin(np.arange(len(image)) / 60)[:, None]), 0.1),  # measured 0.05
        (lambda image: brighter(image, np.linspace(0.6, 1.2, image.shape[1])), 0.1),  # measured 0.05
    ],
    ids=["darker", "a jump", "lamps", "a darker side"],
)
def test_no_change_of_brightness_moves_points(texture, change, bound):
    found, error = followed(texture, change)
    expected, least = followed(texture, lambda image: image)
    assert found > 0.95 * expected
    assert 0.01 < least < 0.04  # measured 0.020
    assert error < bound


def test_an_image_is_worked_on_once(texture, monkeypatch):
    calls = []
    monkeypatch.setattr(
        "fvslam_graph.features.klt.relative_brightness", lambda *a: calls.append(a) or relative_brightness(*a)
    )
    tracker, image = KltTracker(FeatureSettings()), texture(SHIFT)
    tracker.set_keyframe(texture(), Tracks.none())
    tracker.set_keyframe(image, tracker.track(image))
    assert len(calls) == 2
