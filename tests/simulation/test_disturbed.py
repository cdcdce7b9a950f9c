"""Disturbances of a recording: what each frame shows, and where the camera was."""

from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.simulation.disturbed import DARKNESS, DISTURBANCES, LENGTH
from fvslam_graph.simulation.synthetic import synthetic_sequence

FIRST, FRAMES = 10, 45


@pytest.fixture(scope="module")
def sound():
    """Each image has its number in all pixels but a few."""
    sequence = synthetic_sequence("drive", frames=FRAMES, size="64x48")
    base = np.random.default_rng(0).integers(60, 70, (48, 64)).astype(np.uint8)
    return replace(sequence, load=lambda index: base + np.uint8(index))


def shown(sound, sequence) -> list[int]:
    """Which image of the sound recording each frame shows; -1 for another one."""
    images = [sound.load(index).tobytes() for index in range(len(sound))]
    frames = [sequence.frame(index).image.tobytes() for index in range(len(sequence))]
    return [images.index(frame) if frame in images else -1 for frame in frames]


EXPECTED = {
    "none": [*range(FRAMES)],
    "repeated": [*range(10), 9, *range(11, FRAMES)],
    "frozen": [*range(10), *[9] * LENGTH, *range(25, FRAMES)],
    "swapped": [*range(10), 11, 10, *range(12, FRAMES)],
    "reversed": [*range(10), *range(24, 9, -1), *range(25, FRAMES)],
    "dark": [*range(10), *[-1] * DARKNESS, *range(30, FRAMES)],
} | {name: [*range(10), *[-1] * LENGTH, *range(25, FRAMES)] for name in ("mirrored", "picture", "object", "brightness")}


@pytest.mark.parametrize("name", DISTURBANCES)
def test_what_is_shown(sound, name):
    disturbed = DISTURBANCES[name](sound, FIRST, np.random.default_rng(0))
    seen = shown(sound, disturbed.sequence)
    assert seen == EXPECTED[name]
    assert disturbed.first == FIRST and disturbed.after <= FIRST + LENGTH
    # Whatever a frame after it shows, that is where the camera was; and the stamps tell nothing.
    truth = disturbed.sequence.ground_truth
    for index in range(disturbed.after, len(disturbed.sequence)):
        assert truth.poses[index].equals(sound.ground_truth.poses[seen[index]], 0)
    assert np.array_equal(disturbed.sequence.stamps, sound.stamps[: len(disturbed.sequence)])
    assert len(disturbed.sequence.ground.heights) >= len(disturbed.sequence)


def test_only_a_stuck_image_is_delivered_twice(sound):
    for name in ("mirrored", "picture", "object"):
        sequence = DISTURBANCES[name](sound, FIRST, np.random.default_rng(0)).sequence
        images = {sequence.frame(index).image.tobytes() for index in range(FRAMES)}
        assert len(images) == FRAMES
