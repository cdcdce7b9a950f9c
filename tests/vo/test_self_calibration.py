"""A recording shows what its calibration has left in its images."""

from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.core.errors import EstimationError
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.vo.self_calibration import calibrate_by_tracks


@pytest.fixture(scope="module")
def flight():
    return open_sequence("synthetic:uav?frames=60")


def test_a_lens_that_the_file_does_not_know(flight):
    camera = flight.camera
    bent = flight.recalibrated(camera.corrected(np.array([0, -0.02, 0, 0, 0, 0, 0])))
    found = calibrate_by_tracks(bent)
    k1, k2, p1, p2 = found.camera.coefficients
    assert abs(k1 - 0.02) < 4 * found.sigmas[4]
    assert (
        found.corrected == ("k1",)
        and (k2, p1, p2) == (0, 0, 0)
        and (found.camera.fx, found.camera.cx) == (camera.fx, camera.cx)
    )
    assert 0.0003 < found.sigmas[4] < 0.005
    straight = bent.recalibrated(found.camera)
    rim = np.array([[0.0, 0.0], [camera.width - 1.0, 0.0]])
    assert straight.camera == camera and np.abs(camera.project(found.camera.rays(rim)) - rim).max() > 3


def test_a_file_that_is_right(flight):
    found = calibrate_by_tracks(flight)
    assert found.camera == flight.camera.corrected(np.zeros(7)) and found.corrected == ()
    assert found.sigmas[0] == pytest.approx(0.01 * flight.camera.fx, rel=0.5)  # hardly more than a file's


def test_a_camera_that_stands_still(flight):
    with pytest.raises(EstimationError, match="has 0 pairs of images between which the camera moved enough, 10 are"):
        calibrate_by_tracks(replace(flight.select(0, 5, 1), load=lambda _: flight.load(0)))
