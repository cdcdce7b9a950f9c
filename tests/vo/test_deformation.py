"""How patches are deformed by the change of view, against finite differences."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.inverse_depths import InverseDepths
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.vo.deformation import undeformed
from fvslam_graph.vo.epipolar import MatchedRays

CAMERA = Camera(width=640, height=480, fx=400, fy=400, cx=320, cy=240)
MOTION = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.02, -0.05, 0.1), np.array([0.3, -0.1, 0.8]))
PIXELS = np.array([[100.0, 80.0], [320.0, 250.0], [500.0, 400.0], [600.0, 120.0]])
DEPTHS = np.array([4.0, 7.0, 5.0, 30.0])


def seen(pixels: np.ndarray) -> np.ndarray:
    """Where the current camera sees what the keyframe has at these pixels (N, 2), at its depths."""
    points = CAMERA.rays(pixels) * DEPTHS[:, None]
    return CAMERA.project(np.array([MOTION.transformTo(point) for point in points]))


def tracks(bias: np.ndarray | None) -> Tracks:
    return replace(Tracks.alike(np.arange(len(PIXELS)), PIXELS, seen(PIXELS)), alignment_bias=bias)


def corrected(bias: np.ndarray | None, inverse_depths: np.ndarray = 1 / DEPTHS, sigma: float = 0.0) -> Tracks:
    known = InverseDepths.independent(np.arange(len(PIXELS)), inverse_depths, np.full(len(PIXELS), sigma))
    given = tracks(bias)
    matched = MatchedRays.of(CAMERA, given)
    return undeformed(given, matched, MOTION.rotation(), MOTION.translation(), known)


@pytest.mark.parametrize("axis", [0, 1])
def test_deformation_by_finite_differences(axis):
    """Of a plane that faces the keyframe: a patch whose bias is one element of its deformation is moved by that."""
    step = 1e-4 * np.eye(2)[axis]
    change = (seen(PIXELS + step) - seen(PIXELS - step)) / 2e-4 - np.eye(2)[axis]
    for component in (0, 1):
        bias = np.zeros((len(PIXELS), 2, 2, 2))
        bias[:, 0, component, axis] = 1.0
        moved = seen(PIXELS) - corrected(bias).current
        assert moved[:, 0] == pytest.approx(change[:, component], abs=1e-6)
        assert moved[:, 1] == pytest.approx(0)


def test_where_the_image_was_turned_patches_are_deformed_by_what_is_left():
    turn, step = 0.4, 1e-4
    R = gtsam.Rot2(turn).matrix()
    across, down = ((seen(PIXELS + step * e) - seen(PIXELS - step * e)) / (2 * step) for e in np.eye(2))
    left = np.stack([across, down], axis=2)  # (N, 2, 2) of the image
    left = R.T @ left - np.eye(2)  # and of the image that is turned back
    bias = np.random.default_rng(0).normal(0, 0.3, (len(PIXELS), 2, 2, 2))
    given = replace(tracks(bias), turn=turn)
    known = InverseDepths.independent(given.ids, 1 / DEPTHS, np.zeros(len(PIXELS)))
    moved = undeformed(given, MatchedRays.of(CAMERA, given), MOTION.rotation(), MOTION.translation(), known)
    expected = np.einsum("nijk,njk->ni", bias, left) @ R.T
    assert given.current - moved.current == pytest.approx(expected, abs=1e-6)


def test_depths_that_are_noise_bring_nothing_nearer():
    bias = np.zeros((len(PIXELS), 2, 2, 2))
    bias[:, 0, 0, 0] = 1.0
    far = corrected(bias, np.zeros(len(PIXELS))).current
    assert corrected(bias, sigma=1e3).current == pytest.approx(far, abs=1e-6)
    assert np.abs(corrected(bias).current - far).max() > 0.1


def test_a_tracker_without_a_bias_is_right_as_it_is():
    assert corrected(None).current == pytest.approx(seen(PIXELS))
