"""Images that are turned back: what counts as a turn, and that points come back to where they were."""

import cv2
import gtsam
import numpy as np
import pytest

from fvslam_graph.features.turn import MIN_TURN, Turn

POINTS = np.random.default_rng(0).uniform(20, 200, (40, 2)).astype(np.float32)
SHIFT = np.array([7.0, -4.0])


def rolled(angle: float, zoom: float = 1.0) -> np.ndarray:
    return (zoom * POINTS @ gtsam.Rot2(angle).matrix().T + SHIFT).astype(np.float32)


@pytest.mark.parametrize("angle", [0.2, -1.5, 3.0])
def test_a_turn_is_found_whatever_the_zoom(angle):
    turn = Turn.between(POINTS, rolled(angle, zoom=1.1))
    assert turn.angle == pytest.approx(angle, abs=1e-5)
    exact = Turn.between(POINTS, rolled(angle))
    assert exact.out_of_upright(POINTS) == pytest.approx(rolled(angle), abs=1e-3)
    assert exact.into_upright(rolled(angle)) == pytest.approx(POINTS, abs=1e-3)


def test_what_is_little_or_no_turn_needs_none():
    assert Turn.between(POINTS, rolled(0.9 * MIN_TURN)) is None
    assert Turn.between(POINTS, rolled(0.0, zoom=1.3)) is None
    assert Turn.between(POINTS[:1], rolled(1.0)[:1]) is None


def test_an_image_is_turned_back_to_the_keyframe(texture):
    keyframe = texture()
    turn = Turn.between(POINTS, rolled(0.3))
    seen = cv2.warpAffine(keyframe, turn.affine, keyframe.shape[::-1], flags=cv2.INTER_CUBIC)
    inner = np.s_[60:160, 80:200]
    assert np.abs(turn.upright(seen)[inner].astype(float) - keyframe[inner]).mean() < 3
    assert np.abs(seen[inner].astype(float) - keyframe[inner]).mean() > 20


def test_covariances_are_turned_with_the_image():
    turn = Turn.between(POINTS, rolled(np.pi / 2))
    assert turn.turned(np.diag([4.0, 1.0])[None]) == pytest.approx(np.diag([1.0, 4.0])[None], abs=1e-5)
