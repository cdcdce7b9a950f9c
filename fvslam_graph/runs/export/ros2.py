"""A bag of ROS 2 (MCAP): a pose message a frame and the transform to the camera, by rosbags, without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.extras import require
from fvslam_graph.runs.export.poses import ExportedPoses

POSE_TOPIC, TF_TOPIC = "/fvslam/pose", "/tf"
WORLD_FRAME, CAMERA_FRAME = "world", "camera"
FRAMES_NOTE = (
    f"frames: '{WORLD_FRAME}', which is the first camera, and '{CAMERA_FRAME}'; both have x right, y down, z forward"
)


def write(path: Path, poses: ExportedPoses) -> tuple[str, ...]:
    """Write the folder of a bag: `/fvslam/pose`, of PoseWithCovarianceStamped, and `/tf` from `world` to `camera`.

    The covariance is ROS's: position before rotation, both along the fixed axes of `world`. Without covariances, poses
    are PoseStamped.

    Raises:
        FvslamError: rosbags is not installed.
        ResultsError: A stamp is before 1970, which bags do not have.
    """
    require("bags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    if poses.nanoseconds[0] < 0:
        raise ResultsError(f"{poses.run.name} begins at {poses.trajectory.stamps[0]:g} s; bags have no stamps below 0")
    store = get_typestore(Stores.ROS2_HUMBLE)
    messages = _Messages(store.types)
    covariances = poses.fixed_axes_covariances
    kind = "PoseStamped" if covariances is None else "PoseWithCovarianceStamped"
    # Version 8 of the metadata is the newest that Humble reads, too.
    with Writer(path, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        posed = writer.add_connection(POSE_TOPIC, f"geometry_msgs/msg/{kind}", typestore=store)
        moved = writer.add_connection(TF_TOPIC, "tf2_msgs/msg/TFMessage", typestore=store)
        for n, (stamp, position, quaternion) in enumerate(
            zip(poses.nanoseconds, poses.trajectory.positions, poses.quaternions, strict=True)
        ):
            header = messages.header(stamp)
            pose = messages.pose(position, quaternion)
            if covariances is not None:
                pose = messages.make("geometry_msgs/msg/PoseWithCovariance", pose, covariances[n].ravel())
            message = messages.make(posed.msgtype, header, pose)
            writer.write(posed, stamp, store.serialize_cdr(message, posed.msgtype))
            transform = messages.transform(header, position, quaternion)
            writer.write(moved, stamp, store.serialize_cdr(transform, moved.msgtype))
    return (FRAMES_NOTE,)


class _Messages:
    """Makes messages of a ROS distribution's types."""

    def __init__(self, types: Any) -> None:
        self._types = types

    def make(self, name: str, *fields: Any) -> Any:
        """A message with these fields, in their order."""
        return self._types[name](*fields)

    def header(self, stamp: int) -> Any:
        """The header of a pose in WORLD_FRAME at a stamp in nanoseconds."""
        time = self.make("builtin_interfaces/msg/Time", *divmod(stamp, 10**9))
        return self.make("std_msgs/msg/Header", time, WORLD_FRAME)

    def pose(self, position: np.ndarray, quaternion: np.ndarray) -> Any:
        """Position (3,), m, and quaternion x, y, z, w, (4,)."""
        return self.make(
            "geometry_msgs/msg/Pose",
            self.make("geometry_msgs/msg/Point", *position.tolist()),
            self.make("geometry_msgs/msg/Quaternion", *quaternion.tolist()),
        )

    def transform(self, header: Any, position: np.ndarray, quaternion: np.ndarray) -> Any:
        """A TFMessage that takes coordinates of CAMERA_FRAME to the frame of the header."""
        transform = self.make(
            "geometry_msgs/msg/Transform",
            self.make("geometry_msgs/msg/Vector3", *position.tolist()),
            self.make("geometry_msgs/msg/Quaternion", *quaternion.tolist()),
        )
        stamped = self.make("geometry_msgs/msg/TransformStamped", header, CAMERA_FRAME, transform)
        return self.make("tf2_msgs/msg/TFMessage", [stamped])
