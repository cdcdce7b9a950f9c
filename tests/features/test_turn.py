"""Images that are turned back: what counts as a turn, and that an image comes back to how the keyframe was held."""

import cv2
import gtsam
import numpy as np
import pytest

from fvslam_graph.features.turn import MIN_TURN, expected_turn, turned_back

POINTS = np.random.default_rng(0).uniform(20, 200, (40, 2)).astype(np.float32)
SHIFT = np.array([7.0, -4.0])


def rolled(angle: float, zoom: float = 1.0) -> np.ndarray:
    return (zoom * POINTS @ gtsam.Rot2(angle).matrix().T + SHIFT).astype(np.float32)


@pytest.mark.parametrize("angle", [0.2, -1.5, 3.0])
def test_a_turn_is_found_whatever_the_zoom(angle):
    assert expected_turn(POINTS, rolled(angle, zoom=1.1)).theta() == pytest.approx(angle, abs=1e-5)
    exact = expected_turn(POINTS, rolled(angle))
    assert pytest.approx(rolled(angle), abs=1e-3) == exact.transformFrom(POINTS.T.astype(float)).T


def test_what_is_little_or_no_turn_needs_none():
    assert expected_turn(POINTS, rolled(0.9 * MIN_TURN)) is None
    assert expected_turn(POINTS, rolled(0.0, zoom=1.3)) is None
    assert expected_turn(POINTS[:1], rolled(1.0)[:1]) is None


def test_an_image_is_turned_back_to_the_keyframe(texture):
    keyframe = texture()
    turn = expected_turn(POINTS, rolled(0.3))
    seen = cv2.warpAffine(keyframe, turn.matrix()[:2], keyframe.shape[::-1], flags=cv2.INTER_CUBIC)
    inner = np.s_[60:160, 80:200]
    assert np.abs(turned_back(seen, turn)[inner].astype(float) - keyframe[inner]).mean() < 3
    assert np.abs(seen[inner].astype(float) - keyframe[inner]).mean() > 20
