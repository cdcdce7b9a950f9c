"""Patches warped to another view, searched and aligned."""

import cv2
import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera
from fvslam_graph.features.patches import REACH, SIDE, align, cut_tiles, search, view_change, warp

CAMERA = Camera(320, 240, 250.0, 240.0, 159.5, 119.5)


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(0).standard_normal((240, 320)), (0, 0), 1.5)
    return np.clip(np.rint(128 + 45 * noise / noise.std()), 0, 255).astype(np.uint8)


def moved(image: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """The image under a map (2, 3) of pixels."""
    return cv2.warpAffine(image, matrix, (image.shape[1], image.shape[0]), flags=cv2.INTER_CUBIC)


POINTS = np.array([[100.3, 80.0], [160.5, 120.25], [220.0, 150.75]])


def patches_of(image: np.ndarray, points: np.ndarray, change: np.ndarray | None = None):
    change = np.tile(np.eye(2), (len(points), 1, 1)) if change is None else change
    return warp(cut_tiles(image, points), REACH + points - np.rint(points), change)


def test_a_patch_is_what_is_around_its_point(image):
    patches, within = patches_of(image, np.array([[100.5, 80.5]]))
    assert within.all() and patches.shape == (1, SIDE, SIDE)
    half = SIDE // 2
    assert np.array_equal(patches[0], image[81 - half : 81 + half, 101 - half : 101 + half])


def test_a_patch_that_needs_more_than_its_tile_is_told(image):
    _, within = patches_of(image, POINTS, np.array([np.eye(2), 3.0 * np.eye(2), 0.5 * np.eye(2)]))
    assert within.tolist() == [True, False, True]


def test_tiles_at_the_rim_repeat_it(image):
    tiles = cut_tiles(image, np.array([[0.0, 0.0], [319.0, 239.0]]))
    assert np.all(tiles[0, : REACH + 1, : REACH + 1] == image[0, 0])
    assert np.all(tiles[1, REACH:, REACH:] == image[239, 319])


@pytest.mark.parametrize("seed", range(10))
def test_view_change_by_finite_differences(seed):
    """Of a plane that faces the anchor: a pixel beside the middle is followed to the anchor's image and back."""
    rng = np.random.default_rng(seed)
    anchor_T_camera = gtsam.Pose3.Expmap(np.concatenate([0.2 * rng.standard_normal(3), rng.standard_normal(3)]))
    point = np.array([0.5, -0.3, 6.0]) + rng.standard_normal(3)
    there = anchor_T_camera.transformFrom(point)
    normal = there / np.linalg.norm(there)

    def in_anchor(pixel: np.ndarray) -> np.ndarray:
        ray = anchor_T_camera.rotation().rotate(np.append(CAMERA.normalize(pixel)[0], 1.0))
        origin = anchor_T_camera.translation()
        depth = normal @ (there - origin) / (normal @ ray)
        return CAMERA.project(origin + depth * ray)[0]

    pixel = CAMERA.project(point)[0]
    step = 1e-4
    numerical = np.column_stack(
        [(in_anchor(pixel + step * e) - in_anchor(pixel - step * e)) / (2 * step) for e in np.eye(2)]
    )
    change = view_change(anchor_T_camera.matrix()[None], point[None], CAMERA)[0]
    assert change == pytest.approx(numerical, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("turn", [0.0, 0.3])
@pytest.mark.parametrize("larger", [0.7, 1.0, 1.5])
def test_found_again_in_a_turned_and_scaled_image(image, turn, larger):
    matrix = cv2.getRotationMatrix2D((160, 120), np.degrees(turn), larger)
    matrix[:, 2] += (5.3, -7.8)
    there = POINTS @ matrix[:, :2].T + matrix[:, 2]
    change = np.tile(np.linalg.inv(matrix[:, :2]), (len(POINTS), 1, 1))
    patches, within = patches_of(image, POINTS, change)
    assert within.all()
    other = np.clip(0.7 * moved(image, matrix) + 30, 0, 255).astype(np.uint8)  # darker, with less contrast
    expected = there + np.array([6.0, -4.0])
    found, correlation = search(other, patches, expected, np.tile(16.0 * np.eye(2), (3, 1, 1)), 9.21, 40)
    assert np.abs(found - there).max() < 2.0 and correlation.min() > 0.7
    aligned, correlation = align(other, patches, found)
    assert np.abs(aligned - there).max() < 0.15  # measured 0.03 to 0.08
    assert correlation.min() > 0.9


def test_only_the_ellipse_is_searched(image):
    patches, _ = patches_of(image, POINTS)
    narrow = np.tile(np.diag([1.0, 400.0]), (3, 1, 1))  # 3 pixels across, 60 up and down
    found, correlation = search(image, patches, POINTS + np.array([0.0, 30.0]), narrow, 9.21, 80)
    assert np.abs(found - POINTS).max() < 2 and correlation.min() > 0.8
    found, correlation = search(image, patches, POINTS + np.array([20.0, 0.0]), narrow, 9.21, 80)
    assert np.abs(found - POINTS).min(axis=0)[0] > 10 and correlation.max() < 0.8
    found, correlation = search(image, patches, POINTS + np.array([0.0, 30.0]), narrow, 9.21, 10)  # a bound on how far
    assert correlation.max() < 0.8


def test_what_is_not_in_the_image_is_not_found(image):
    patches, _ = patches_of(image, POINTS)
    outside = np.array([[-50.0, 80.0], [400.0, 120.0], [220.0, 500.0]])
    _, correlation = search(image, patches, outside, np.tile(4.0 * np.eye(2), (3, 1, 1)), 9.21, 40)
    assert np.all(correlation == -1)


def test_flat_patches_stay_where_they_are():
    grey = np.full((240, 320), 90, np.uint8)
    patches, _ = patches_of(grey, POINTS)
    aligned, correlation = align(grey, patches, POINTS)
    assert np.array_equal(aligned, POINTS)
    assert np.abs(correlation).max() < 1e-3


def test_alignment_averages_noise(image):
    """A twentieth of a pixel with noise of five grey levels; not less than a thousandth, which would be no test."""
    rng = np.random.default_rng(1)
    points = rng.uniform((40, 40), (280, 200), (60, 2))
    noisy = [np.clip(np.rint(image + 5 * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8) for _ in range(2)]
    patches, _ = patches_of(noisy[0], points)
    aligned, _ = align(noisy[1], patches, points + rng.uniform(-1, 1, points.shape))
    assert 1e-3 < np.sqrt(np.mean((aligned - points) ** 2)) < 0.05  # measured 0.015


def test_nothing_to_align(image):
    aligned, correlation = align(image, np.empty((0, SIDE, SIDE), np.float32), np.empty((0, 2)))
    assert aligned.shape == (0, 2) and len(correlation) == 0
