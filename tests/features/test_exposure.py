"""Changes of brightness, and what is none."""

import numpy as np
import pytest

from fvslam_graph.core.config import FeatureSettings
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.features.exposure import exposed, exposure_change, reduced
from fvslam_graph.features.klt import KltTracker


@pytest.mark.parametrize(("gain", "offset"), [(0.7, 0.0), (0.84, 45.0), (1.1, -30.0), (1.0, 20.0)])
def test_gain_and_offset(texture, gain, offset):
    before, after = texture(band=0.02), exposed(texture((2.0, 1.0), band=0.02), gain, offset)
    assert exposure_change(reduced(before), reduced(after)) == pytest.approx((gain, offset), abs=5)


def test_what_is_no_change_of_exposure(texture):
    image = texture(band=0.02)
    assert exposure_change(reduced(image), reduced(image)) is None
    assert exposure_change(reduced(image), reduced(texture(seed=1, band=0.02))) is None  # another scene
    assert exposure_change(reduced(image), reduced(np.zeros_like(image))) is None
    assert exposure_change(reduced(np.full_like(image, 90)), reduced(np.full_like(image, 120))) is None


@pytest.mark.parametrize(("gain", "offset"), [(0.84, 45.0), (0.7, 0.0)])
def test_a_jump_of_the_exposure_loses_no_tracks(texture, gain, offset):
    shifts = [(1.0 * step, -0.5 * step) for step in range(1, 7)]
    found = {}
    for jumps in (False, True):
        tracker = KltTracker(FeatureSettings())
        tracker.set_keyframe(texture(), Tracks.none())
        for step, shift in enumerate(shifts):
            image = texture(shift)
            tracks = tracker.track(exposed(image, gain, offset) if jumps and step >= 3 else image)
            error = np.linalg.norm(tracks.current - tracks.keyframe - shift, axis=1)
            assert np.median(error) < 0.05
        found[jumps] = len(tracks)
    assert found[True] > 0.95 * found[False]


def test_of_tiny_images():
    tiny = np.random.default_rng(0).integers(0, 255, (5, 7)).astype(np.uint8)
    assert exposure_change(reduced(tiny), reduced(tiny)) is None
