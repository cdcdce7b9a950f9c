"""Bags, read back by rosbags."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

import fvslam_graph
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.runs.export.poses import ExportedPoses


def messages(path):
    store, found = get_typestore(Stores.ROS2_HUMBLE), {}
    with Reader(path) as reader:
        for connection, stamp, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((stamp, message))
    return found


def pose_of(position, q):
    return gtsam.Pose3(gtsam.Rot3.Quaternion(q.w, q.x, q.y, q.z), np.array([position.x, position.y, position.z]))


def test_poses_and_transforms(run, tmp_path):
    done = fvslam_graph.export(run, "ros2", tmp_path / "bag")
    assert "'world'" in done.notes[0]
    found = messages(tmp_path / "bag")
    assert {topic: len(list_) for topic, list_ in found.items()} == {"/fvslam/pose": 8, "/tf": 8}
    covariances = ExportedPoses.of(run, smoothed=False).fixed_axes_covariances
    for n, ((stamp, posed), (_, moved)) in enumerate(zip(found["/fvslam/pose"], found["/tf"], strict=True)):
        (transform,) = moved.transforms
        for header in (posed.header, transform.header):
            assert header.frame_id == "world"
            assert stamp == header.stamp.sec * 10**9 + header.stamp.nanosec
        assert stamp / 1e9 == pytest.approx(run.online.stamps[n], abs=1e-6)
        assert transform.child_frame_id == "camera"
        pose, moved = posed.pose.pose, transform.transform
        assert pose_of(pose.position, pose.orientation).equals(run.online.poses[n], 1e-9)
        assert pose_of(moved.translation, moved.rotation).equals(run.online.poses[n], 1e-9)
        assert np.array_equal(posed.pose.covariance.reshape(6, 6), covariances[n])


def test_without_covariances_poses_have_none(run, tmp_path):
    fvslam_graph.export(replace(run, pose_covariances=None), "ros2", tmp_path / "bag")
    assert {type(message).__name__ for _, message in messages(tmp_path / "bag")["/fvslam/pose"]} == {
        "geometry_msgs__msg__PoseStamped"
    }


def test_stamps_below_zero(run, tmp_path):
    early = replace(run, online=Trajectory(np.arange(8) - 1.0, run.online.poses))
    with pytest.raises(FvslamError, match="flight begins at -1 s"):
        fvslam_graph.export(early, "ros2", tmp_path / "bag")
    assert not list(tmp_path.iterdir())
