"""What an alignment by shifts alone errs by, against the tracker itself."""

import cv2
import numpy as np
import pytest

from fvslam_graph.core.config import FeatureSettings
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.features.alignment_bias import alignment_bias
from fvslam_graph.features.klt import KltTracker

SIZE = 240
POINTS = np.array([(x, y) for x in range(40, 201, 20) for y in range(40, 201, 20)], np.float32)
ZOOM, ROLL, SHEAR = np.eye(2), np.array([[0, -1], [1, 0]]), np.array([[0, 1], [0, 0]])


@pytest.fixture(scope="module")
def scene() -> np.ndarray:
    noise = np.random.default_rng(0).normal(0, 1, (SIZE, SIZE))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2)
    return np.clip(128 + 50 * smooth / smooth.std(), 0, 255).astype(np.uint8)


def found(scene: np.ndarray, point: np.ndarray, deformation: np.ndarray) -> np.ndarray:
    """Where the tracker has a point around which the image is deformed, without going anywhere, (2,)."""
    forward = np.eye(2) + deformation
    moved = cv2.warpAffine(
        scene, np.column_stack([forward, point - forward @ point]), (SIZE, SIZE), flags=cv2.INTER_CUBIC
    )
    settings = FeatureSettings()
    window = (settings.klt_window, settings.klt_window)
    there, status, _ = cv2.calcOpticalFlowPyrLK(scene, moved, point[None], None, winSize=window, maxLevel=0)
    assert status.all()
    return there[0]


@pytest.mark.parametrize(("kind", "size"), [(ZOOM, 0.05), (ZOOM, -0.05), (ROLL, 0.05), (SHEAR, 0.05)])
def test_it_is_what_the_tracker_errs_by(scene, kind, size):
    bias = alignment_bias(scene, POINTS, FeatureSettings().klt_window)
    expected = np.einsum("nijk,jk->ni", bias, size * kind)
    errors = np.array([found(scene, point, size * kind) for point in POINTS]) - POINTS
    left = np.linalg.norm(errors - expected, axis=1)
    assert np.median(np.linalg.norm(errors, axis=1)) > 0.05  # pixels; measured 0.07 to 0.11
    assert np.median(left) < 0.35 * np.median(np.linalg.norm(errors, axis=1))


def test_a_patch_that_looks_alike_all_around_is_not_biased():
    image = np.zeros((41, 41), np.uint8)
    cv2.circle(image, (20, 20), 4, 255, -1)
    bias = alignment_bias(image, np.array([[20, 20]], np.float32), 11)
    assert bias == pytest.approx(0, abs=1e-3)


def test_without_texture_and_at_the_rim_it_is_finite():
    image = np.zeros((40, 60), np.uint8)
    image[:, 30:] = 200  # an edge
    points = np.array([[10, 20], [30, 20], [0, 0], [59, 39]], np.float32)
    assert np.isfinite(alignment_bias(image, points, 11)).all()


def test_tracks_carry_it(scene):
    tracker = KltTracker(FeatureSettings(count=60))
    points = tracker.set_keyframe(scene, Tracks.none())
    tracks = tracker.track(scene)
    assert tracks.alignment_bias.shape == (len(tracks), 2, 2, 2)
    assert tracks[np.arange(3)].alignment_bias == pytest.approx(points[np.arange(3)].alignment_bias)
