"""Odometry where there is no PoseLib: OpenCV's RANSAC finds the poses that are refined."""

from fvslam_graph.core.config import load_config
from fvslam_graph.core.trajectory import Status, Trajectory
from fvslam_graph.estimator import estimate
from fvslam_graph.features import ransac
from fvslam_graph.testing import assert_ape_below


def test_a_flight(uav_sequence, monkeypatch):
    monkeypatch.setattr(ransac, "poselib", None)
    results = list(estimate(uav_sequence, load_config()))
    assert [result.status for result in results] == [Status.STATIC] + 39 * [Status.TRACKED]
    online = Trajectory(uav_sequence.stamps, tuple(result.pose.mean for result in results))
    assert_ape_below(online, 0.2, uav_sequence.ground_truth)  # metres on 49 m; measured 0.065, as by PoseLib
