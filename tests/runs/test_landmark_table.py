"""What is kept of the landmarks of a frame."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.slam_estimate import LandmarkMatches, Landmarks, MatchOutcome, SlamEstimate
from fvslam_graph.core.trajectory import Status
from fvslam_graph.runs.landmark_table import LANDMARK_COLUMNS, NEW, landmark_rows, read_landmarks


@pytest.fixture
def estimate() -> SlamEstimate:
    """Landmark 3 was measured, 5 not found and dropped, 8 begins."""
    searched = LandmarkMatches(
        ids=np.array([5, 3]),
        outcome=np.array([MatchOutcome.UNMATCHED, MatchOutcome.INLIER]),
        expected=np.array([[10.0, 20.0], [30.0, 40.0]]),
        ellipses=np.array([[[4.0, 1.0], [1.0, 9.0]], np.eye(2)]),
        pixels=np.array([[np.nan, np.nan], [31.0, 41.5]]),
    )
    covariances = np.arange(18.0).reshape(2, 3, 3)
    landmarks = Landmarks(
        ids=np.array([3, 8]),
        pixels=np.array([[31.2, 41.4], [100.0, 50.0]]),
        points=np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
        covariances=(covariances + covariances.mT) / 2,
        ages=np.array([7, 0]),
    )
    pose = GaussianPose(gtsam.Pose3(), np.eye(6))
    return SlamEstimate(12, 11, pose, pose, Status.TRACKED, searched, landmarks, 0.1, {})


def test_a_line_for_every_landmark(estimate):
    lines = [line.split(",") for line in landmark_rows(estimate).splitlines()]
    assert [line[:4] for line in lines] == [
        ["12", "3", "inlier", "7"],
        ["12", "5", "unmatched", ""],
        ["12", "8", NEW, "0"],
    ]
    assert all(len(line) == len(LANDMARK_COLUMNS) for line in lines)


def test_read_back(estimate, tmp_path):
    path = tmp_path / "landmarks.csv"
    path.write_text(",".join(LANDMARK_COLUMNS) + "\n" + landmark_rows(estimate))
    table = read_landmarks(path, 12)
    assert table["id"].tolist() == [3, 5, 8]
    assert table["u"] == pytest.approx([31.0, np.nan, 100.0], nan_ok=True)
    assert table["expected_v"] == pytest.approx([40.0, 20.0, np.nan], nan_ok=True)
    assert table["ellipse_uv"] == pytest.approx([0.0, 1.0, np.nan], nan_ok=True)
    assert table["z"] == pytest.approx([3.0, np.nan, 6.0], nan_ok=True)
    assert table["cov_yz"] == pytest.approx([6.0, np.nan, 15.0], nan_ok=True)
    assert len(read_landmarks(path, 1)["id"]) == 0  # frame 12 is not frame 1
