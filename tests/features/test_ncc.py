"""Matching of patches: known shifts are found, each corner is used once, what is not alike is left."""

import numpy as np
import pytest

from fvslam_graph.core.config import FeatureSettings, load_config
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.features.ncc import NccMatcher

SETTINGS = load_config("paper").features


def match(keyframe, image, settings=SETTINGS) -> Tracks:
    matcher = NccMatcher(settings)
    matcher.set_keyframe(keyframe, Tracks.none())
    return matcher.track(image)


def misses(tracks: Tracks, shift) -> np.ndarray:
    return np.linalg.norm(tracks.current - tracks.keyframe - shift, axis=1)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (5.0, -3.0), (3.6, 2.3), (40.5, 20.5)])
def test_a_known_shift_is_found(texture, shift):
    tracks = match(texture(noise=1.0), texture(shift, noise=1.0))
    missed = misses(tracks, shift)
    right = missed < 2
    assert len(tracks) > 150
    assert right.mean() > 0.85  # measured 0.93 to 1
    assert 0.005 < np.median(missed) < 0.3  # measured 0.04 to 0.19
    # Rounding to whole pixels would be alike over the image; it is gone.
    assert np.abs(np.mean(tracks[right].current - tracks[right].keyframe - shift, axis=0)).max() < 0.1


def test_no_corner_is_matched_twice(texture):
    tracks = match(texture(), texture((2.5, 1.5), noise=8.0))
    assert len(tracks) > 100
    for pixels in (tracks.keyframe, tracks.current):
        assert len(np.unique(pixels, axis=0)) == len(tracks)
    assert len(np.unique(tracks.ids)) == len(tracks)


def test_what_is_not_alike_is_rejected(texture):
    keyframe, other = texture(band=0.2), texture(seed=7, band=0.2)
    assert len(match(keyframe, keyframe)) > 300
    assert len(match(keyframe, other)) == 0
    # Without a threshold there are always mutual best matches.
    assert len(match(keyframe, other, SETTINGS.model_copy(update={"ncc_threshold": 0.0}))) > 50


def test_brightness_and_contrast_do_not_matter(texture):
    image = texture()
    darker = (30 + 0.5 * image).astype(np.uint8)
    plain, changed = match(image, image), match(image, darker)
    assert len(changed) > 0.7 * len(plain)  # measured 0.81: fainter corners are not detected
    # A corner that is too faint in the darker image may be matched with another one: measured 1 in some 100.
    assert np.mean(misses(changed, 0) > 0.5) < 0.03


def test_nothing_is_matched_beyond_the_radius(texture):
    settings = SETTINGS.model_copy(update={"ncc_radius": 10.0})
    tracks = match(texture(), texture((30.0, 0.0)), settings)
    assert np.abs(tracks.current - tracks.keyframe).max() < 11  # a fraction of a pixel is found after the search
    assert not np.any(misses(tracks, (30.0, 0.0)) < 5)


def test_an_image_without_texture(texture):
    image = texture()
    black = np.zeros_like(image)
    assert len(match(image, black)) == len(match(black, image)) == len(match(black, black)) == 0
    assert len(NccMatcher(FeatureSettings()).track(image)) == 0


def test_points_keep_their_ids(texture):
    matcher = NccMatcher(SETTINGS)
    first = matcher.set_keyframe(texture(), Tracks.none())
    tracks = matcher.track(texture((3.0, 2.0)))
    points = matcher.set_keyframe(texture((3.0, 2.0)), tracks)
    assert np.array_equal(points.ids[: len(tracks)], tracks.ids)
    assert len(np.unique(points.ids)) == len(points)
    assert points.ids[len(tracks) :].min() > first.ids.max()
    again = matcher.track(texture((6.0, 4.0)))
    assert np.median(misses(again, (3.0, 2.0))) < 0.3
