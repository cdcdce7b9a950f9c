"""Ground truth in a bag: which topic has it, and how it is brought to the camera."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.sequences.ros.frames import FrameTree, Numbers, frame_name, pose_numbers, stamped_poses
from fvslam_graph.sequences.ros.reader import Topic, stamp_of

# In order of preference: what motion capture publishes, then what may be somebody's estimate.
POSE_TYPES = (
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/PoseStamped",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
)

_TRUE = re.compile(r"ground_?truth|(^|[/_])gt([/_]|$)|vicon|vrpn|optitrack|mocap|qualisys", re.IGNORECASE)
_WANTED = re.compile(r"goal|set_?point|target|initial_?pose|command|cmd|desired", re.IGNORECASE)  # and not measured


def by_preference(topics: Sequence[Topic]) -> list[Topic]:
    """The topics that measure poses, best first: those that are named after a reference, then by their type."""
    measured = [topic for topic in topics if topic.count > 1 and not _WANTED.search(topic.name)]
    return sorted(measured, key=lambda topic: (not _TRUE.search(topic.name), POSE_TYPES.index(topic.type), topic.name))


def pose_of(message: Any) -> tuple[str, int, Numbers]:
    """The frame whose pose a message tells ("" where it does not say), its stamp (ns) and the pose's numbers."""
    child = frame_name(getattr(message, "child_frame_id", ""))
    if hasattr(message, "transform"):
        return child, stamp_of(message), pose_numbers(message.transform.translation, message.transform.rotation)
    pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
    return child, stamp_of(message), pose_numbers(pose.position, pose.orientation)


def camera_poses(
    path: Path, rows: Sequence[tuple[str, int, Numbers]], tree: FrameTree, camera: str
) -> tuple[Trajectory, tuple[str, ...]]:
    """world_T_camera from poses of a body, and a note where nobody says how the camera sits on it.

    Args:
        path: Of the bag.
        rows: What `pose_of` makes of the messages, one at least.
        tree: The frames of the bag.
        camera: The camera's frame.
    """
    poses = stamped_poses(path, ((stamp, numbers) for _, stamp, numbers in rows))
    notes: tuple[str, ...] = ()
    if (left_out := len(rows) - len(poses)) > 0:
        notes += (f"{left_out} poses of the ground truth are none, or repeat a stamp, and are left out",)
    body = rows[0][0] or tree.carrier(camera)
    if body == camera and rows[0][0]:
        return poses, notes
    body_T_camera = tree.fixed(body, camera) if body != camera else None
    if body_T_camera is None:
        return poses, (*notes, "no TF says how the camera sits on the body: their frames are taken as one")
    return replace(poses, poses=tuple(pose * body_T_camera for pose in poses.poses)), notes
