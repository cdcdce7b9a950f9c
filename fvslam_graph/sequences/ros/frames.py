"""Coordinate frames in a bag (TF): which sit fixed on each other, and how the others move."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import gtsam
import numpy as np

from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.sequences.ros.reader import stamp_of
from fvslam_graph.sequences.tables import make_trajectory

TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")  # the second is ROS 1's before 2013

Numbers = tuple[float, float, float, float, float, float, float]
"""Position (m) and quaternion: x, y, z, qx, qy, qz, qw."""


class Transform(NamedTuple):
    """The pose parent_T_child at a time, ns."""

    parent: str
    child: str
    stamp: int
    numbers: Numbers


def frame_name(name: str) -> str:
    """A frame's name without the slash that ROS 1 allowed in front."""
    return name.lstrip("/")


def pose_numbers(position: Any, rotation: Any) -> Numbers:
    """The numbers of a message's position or translation, and of its quaternion."""
    return (position.x, position.y, position.z, rotation.x, rotation.y, rotation.z, rotation.w)


def transforms_of(message: Any) -> list[Transform]:
    """The transforms of a TF message."""
    return [
        Transform(
            frame_name(item.header.frame_id),
            frame_name(item.child_frame_id),
            stamp_of(item),
            pose_numbers(item.transform.translation, item.transform.rotation),
        )
        for item in message.transforms
    ]


def stamped_poses(path: Path, rows: Iterable[tuple[int, Numbers]]) -> Trajectory:
    """Poses in the order of their stamps (ns), each stamp once; what is not finite or no rotation is left out.

    Raises:
        TrajectoryError: A position is no place in metres; names `path`.
    """
    poses: dict[int, gtsam.Pose3] = {}
    for stamp, numbers in sorted(rows):
        *position, qx, qy, qz, qw = numbers
        norm = np.linalg.norm(numbers[3:])
        if np.isfinite(numbers).all() and abs(norm - 1) < 0.01:
            rotation = gtsam.Rot3.Quaternion(qw / norm, qx / norm, qy / norm, qz / norm)
            poses.setdefault(stamp, gtsam.Pose3(rotation, np.array(position)))
    return make_trajectory(path, np.array(list(poses), np.int64) / 1e9, list(poses.values()))


class FrameTree:
    """The tree of frames. An edge whose pose never changes is fixed, also where it is published again and again.

    Args:
        path: Of the bag, for messages.
        transforms: All that the bag has.
    """

    def __init__(self, path: Path, transforms: Iterable[Transform]) -> None:
        rows: dict[str, list[Transform]] = defaultdict(list)
        for transform in transforms:
            if not rows[transform.child] or rows[transform.child][0].parent == transform.parent:
                rows[transform.child].append(transform)
        self._parents: dict[str, str] = {}
        self._poses: dict[str, Trajectory] = {}  # parent_T_child; of a fixed edge, a single pose
        for child, edge in rows.items():
            fixed = all(row.numbers == edge[0].numbers for row in edge)
            poses = stamped_poses(path, ((row.stamp, row.numbers) for row in (edge[:1] if fixed else edge)))
            if len(poses) and not self._below(edge[0].parent, child):
                self._parents[child], self._poses[child] = edge[0].parent, poses

    def carrier(self, frame: str) -> str:
        """The outermost frame that this one sits fixed on: the vehicle's; itself where nothing is known."""
        while len(self._poses.get(frame, ())) == 1:
            frame = self._parents[frame]
        return frame

    def fixed(self, a: str, b: str) -> gtsam.Pose3 | None:
        """The pose a_T_b of frames that sit fixed on each other; None where they do not."""
        if self.carrier(a) != self.carrier(b):
            return None
        return self._on_carrier(a).between(self._on_carrier(b))

    def moving(self, frame: str) -> tuple[str, Trajectory] | None:
        """The outermost frame, the world, and world_T_frame over time; None where nothing moves in between."""
        chain = []
        while frame in self._parents:
            chain.append(self._poses[frame])
            frame = self._parents[frame]
        motions = [poses for poses in chain if len(poses) > 1]
        if not motions:
            return None
        stamps = max(motions, key=len).stamps
        for poses in motions:
            stamps = poses.interpolate(stamps).stamps
        world_T_frame = [gtsam.Pose3()] * len(stamps)
        for poses in chain:
            links = poses.poses * len(stamps) if len(poses) == 1 else poses.interpolate(stamps).poses
            world_T_frame = [link * pose for link, pose in zip(links, world_T_frame, strict=True)]
        return frame, Trajectory(stamps, tuple(world_T_frame))

    def _on_carrier(self, frame: str) -> gtsam.Pose3:
        pose = gtsam.Pose3()
        while len(self._poses.get(frame, ())) == 1:
            pose = self._poses[frame].poses[0] * pose
            frame = self._parents[frame]
        return pose

    def _below(self, frame: str, other: str) -> bool:
        """Whether a frame is another one or below it: an edge between them would close a circle."""
        while frame != other and frame in self._parents:
            frame = self._parents[frame]
        return frame == other
