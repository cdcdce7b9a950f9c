"""Images as other cameras would have made them."""

import numpy as np
import pytest

from fvslam_graph.simulation.other_cameras import CORNERS, EFFECTS, VEHICLE, seen_by
from fvslam_graph.testing import rendered


@pytest.fixture(scope="module")
def flight():
    return rendered("uav", frames=3, size="160x120")


@pytest.mark.parametrize("name", EFFECTS)
def test_images_change_and_do_so_again_in_the_same_way(flight, name):
    other = seen_by(flight, EFFECTS[name])
    before, image, again = flight.load(2), other.load(2), other.load(2)
    assert image.dtype == np.uint8
    assert image.shape == before.shape
    assert np.array_equal(image, again)
    assert not np.array_equal(image, before)
    assert np.array_equal(flight.load(2), before)  # which is the caller's
    assert len(other) == len(flight)
    assert other.ground_truth is flight.ground_truth


def test_corners_are_darker_and_the_middle_is_not():
    white = np.full((120, 160), 200, np.uint8)
    image = EFFECTS["corners"](white, 0)
    assert image[0, 0] == round(200 * (1 - CORNERS))
    assert image[60, 80] == pytest.approx(200, abs=1)


def test_the_vehicle_stays_where_it_is():
    images = [
        EFFECTS["vehicle"](np.random.default_rng(k).integers(0, 255, (120, 160)).astype(np.uint8), k) for k in (0, 1)
    ]
    rows = 120 // VEHICLE
    assert np.array_equal(images[0][-rows:], images[1][-rows:])
    assert not np.array_equal(images[0][:-rows], images[1][:-rows])
