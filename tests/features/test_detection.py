"""FAST corners: spread, apart from what exists, away from the rim."""

import math

import cv2
import numpy as np
import pytest

from fvslam_graph.core.config import FeatureSettings
from fvslam_graph.features.detection import BORDER, PER_CELL
from fvslam_graph.features.detection import detect as detect_in
from fvslam_graph.features.texture import Texture

SIZES = pytest.mark.parametrize(("count", "octave"), [(100, 0), (400, 0), (100, 1), (400, 1), (400, 2)])


def detect(image, settings, taken=None):
    return detect_in(Texture.of(image, settings.octave), settings, taken)


def per_cell(points: np.ndarray, shape: tuple[int, ...], count: int) -> np.ndarray:
    """How many of the points (N, 2) are in each cell of the grid."""
    cell = math.ceil(math.sqrt(shape[0] * shape[1] * PER_CELL / count))
    rows, columns = -(-shape[0] // cell), -(-shape[1] // cell)
    edges = [cell * np.arange(rows + 1), cell * np.arange(columns + 1)]
    return np.histogram2d(points[:, 1], points[:, 0], edges)[0]


@SIZES
def test_corners_are_spread(texture, count, octave):
    image = texture()
    corners = detect(image, FeatureSettings(count=count, octave=octave))
    full = per_cell(corners, image.shape, count)
    assert full.max() == PER_CELL
    assert 0.6 * count < len(corners) <= full.size * PER_CELL  # measured 0.68 to 0.96
    assert np.mean(full > 0) > 0.75  # measured 0.8 to 1


@SIZES
def test_no_corner_at_the_rim_or_twice(texture, count, octave):
    image = texture()
    corners = detect(image, FeatureSettings(count=count, octave=octave, spacing=0))
    height, width = image.shape
    assert corners.min() >= BORDER
    assert np.all(corners <= (width - 1 - BORDER, height - 1 - BORDER))
    assert len(np.unique(corners, axis=0)) == len(corners)


@pytest.mark.parametrize("spacing", [1, 3, 8, 15])
def test_new_corners_keep_their_distance(texture, spacing):
    image = texture()
    taken = detect(image, FeatureSettings(count=60, octave=0)).astype(float)
    corners = detect(image, FeatureSettings(count=1000, octave=0, spacing=spacing), taken)
    between = np.abs(np.floor(corners)[:, None] - np.floor(taken)[None]).max(axis=2)
    assert between.min() == spacing + 1  # some corner is as near as it may be


def test_points_that_exist_use_up_their_cell(texture):
    image = texture()
    settings = FeatureSettings(count=200, spacing=2)
    taken = detect(image, settings).astype(float)
    left = taken[taken[:, 0] < 160]
    added = detect(image, settings, left)
    assert added[:, 0].min() > 120 and len(added) > 50  # only where nothing is, apart from the cells between
    assert per_cell(np.vstack([left, added]), image.shape, 200).max() == PER_CELL


def test_the_strongest_are_taken():
    image = np.full((200, 200), 20, np.uint8)
    brightness = {(30, 40): 90, (50, 40): 250, (70, 60): 130, (40, 80): 170, (150, 150): 60, (180, 120): 70}
    for (column, row), value in brightness.items():
        image[row, column] = value
    corners = detect(image, FeatureSettings(count=8, octave=0, spacing=0))  # in cells of 100 pixels
    assert sorted(map(tuple, corners.tolist())) == [(40, 80), (50, 40), (150, 150), (180, 120)]


@pytest.mark.parametrize("octave", [0, 1, 2])
def test_where_a_corner_is(octave):
    image = np.zeros((240, 320), np.uint8)
    cv2.rectangle(image, (96, 80), (223, 159), 255, -1)
    corners = detect(cv2.GaussianBlur(image, (0, 0), 1.0), FeatureSettings(octave=octave))
    assert len(corners) == 4
    # They lie a little inside of the rectangle, alike at all its corners.
    assert corners.mean(axis=0).tolist() == [159.5, 119.5]
    distance = np.linalg.norm(corners[:, None] - [[96, 80], [223, 80], [96, 159], [223, 159]], axis=2)
    assert (distance.min(axis=0) < 2.2 * 2**octave).all()  # measured 1.4, 3.5, 7.8


@pytest.mark.parametrize("shape", [(240, 320), (33, 57), (16, 16), (8, 300)])
def test_nothing_to_see(shape, texture):
    assert detect(np.full(shape, 77, np.uint8), FeatureSettings()).shape == (0, 2)
    taken = np.array([[4.0, 5.0]])
    assert detect(np.full(shape, 77, np.uint8), FeatureSettings(), taken).shape == (0, 2)
    small = np.ascontiguousarray(texture()[: shape[0], : shape[1]])
    assert detect(small, FeatureSettings()).shape[1] == 2


def test_the_same_again(texture):
    image, settings = texture(noise=5.0), FeatureSettings()
    assert np.array_equal(detect(image, settings), detect(image.copy(), settings))
