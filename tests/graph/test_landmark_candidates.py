"""Landmarks that wait until they are known well enough."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.slam_estimate import LandmarkObservations
from fvslam_graph.graph.landmark_candidates import LandmarkCandidates

CAMERA = Camera(640, 480, 450.0, 450.0, 319.5, 239.5)
POINT = np.array([0.2, 0.1, 6.0])
TRUE = [gtsam.Pose3(gtsam.Rot3(), np.array([0.1 * index, 0.0, 0.0])) for index in range(4)]
TURNED = gtsam.Pose3(gtsam.Rot3.Rodrigues(0.0, 0.01, 0.0), TRUE[3].translation())  # 4.5 pixels
SHIFTED = gtsam.Pose3(gtsam.Rot3(), np.array([0.3, 0.05, 0.0]))  # 3.7 pixels


def handed_out(last: gtsam.Pose3, drift_variance: list[np.ndarray]) -> int:
    """How many landmarks enter at the last of four frames, where odometry has the camera there."""
    candidates, poses = LandmarkCandidates(GraphSettings(min_views=4)), [*TRUE[:3], last]
    for index, true in enumerate(TRUE):
        there = true.transformTo(POINT)[None]
        views = LandmarkObservations(np.array([7]), CAMERA.project(there), there, 0.01 * np.eye(3)[None])
        ready = candidates.ready(views, np.zeros(1, bool), poses[: index + 1], drift_variance, lambda _: True, CAMERA)
    return len(ready)


@pytest.mark.parametrize(
    ("last", "drift_variance", "enters"),
    [
        (TRUE[3], [0, 0], True),
        (TURNED, [1e-6, 0], False),
        (TURNED, [1e-4, 0], True),
        (SHIFTED, [0, 0.005**2], False),
        (SHIFTED, [0, 0.05**2], True),
    ],
)
def test_views_agree_as_well_as_odometry_knows_them_to_each_other(last, drift_variance, enters):
    """Else, where odometry has failed, no landmark would enter that could tell where the camera went."""
    exact = np.zeros((2, 2))
    assert handed_out(last, [exact, exact, exact, np.array([drift_variance, [0, 0]])]) == enters


def test_motions_from_one_frame():
    """Each errs on its own, so that they do not know each other's frames better than that."""
    from_one = np.array([[5e-5, 0], [0, 0]])
    assert handed_out(TURNED, [from_one] * 4)
