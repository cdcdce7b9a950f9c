"""What the texture around a point tells of its displacement."""

import cv2
import numpy as np
import pytest

from fvslam_graph.features.alignment_bias import alignment_bias
from fvslam_graph.features.texture import Texture, gradients_around


def drawn(angle: float) -> np.ndarray:
    """An edge through the middle at an angle, and a bright square in the lower left."""
    y, x = np.mgrid[:240, :320] - np.array([120, 160])[:, None, None]
    image = 128 + 50 * np.tanh((x * np.sin(angle) - y * np.cos(angle)) / 2)
    image[180:220, 20:60] = 250
    return np.rint(image).astype(np.uint8)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.5])
def test_an_edge_tells_how_far_it_went_across_and_not_along_itself(angle):
    texture = Texture.of(drawn(angle), 1)
    edge, corner = texture.displacement_covariances(np.array([[160.0, 120.0], [60.0, 180.0]]))
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    assert 1 <= across @ edge @ across < 5
    assert along @ edge @ along > 5e3
    assert np.linalg.eigvalsh(corner) == pytest.approx([1, 1], abs=0.2)


def test_covariances_are_symmetric_and_positive_and_at_most_finite(texture):
    """Also where there is no texture at all, or a point lies at the rim or beyond."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-10, 330, (200, 2))
    for image in (texture(), np.full((240, 320), 77, np.uint8)):
        covariances = Texture.of(image, 1).displacement_covariances(points)
        assert np.isfinite(covariances).all()
        assert np.array_equal(covariances, covariances.mT)
        assert np.linalg.eigvalsh(covariances).min() > 0.999


def test_gradients_are_those_of_the_image(texture):
    """Everywhere but at the rim they are OpenCV's."""
    image = texture()
    middles = np.random.default_rng(0).integers(8, (312, 232), (100, 2))
    for found, expected in zip(gradients_around(image, middles, 5), cv2.spatialGradient(image), strict=True):
        for (x, y), patch in zip(middles, found.T, strict=True):
            assert np.array_equal(patch.reshape(5, 5), expected[y - 2 : y + 3, x - 2 : x + 3])


@pytest.mark.parametrize("size", [(48, 64), (9, 10)])
def test_without_points(size):
    """Also in an image that is smaller than a patch."""
    image, none = np.zeros(size, np.uint8), np.empty((0, 2))
    assert Texture.of(image, 1).displacement_covariances(none).shape == (0, 2, 2)
    assert alignment_bias(image, none.astype(np.float32), 11).shape == (0, 2, 2, 2)
