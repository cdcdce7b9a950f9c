"""Poses as lines of text, for programs that read them while they are estimated."""

from __future__ import annotations

from collections.abc import Callable

from fvslam_graph.core.errors import ConfigError
from fvslam_graph.core.files import json_text
from fvslam_graph.core.frame_result import FrameResult
from fvslam_graph.core.trajectory import tum_line


def pose_line(format: str) -> Callable[[FrameResult], str]:
    """What makes a line, without its end, of a result.

    Args:
        format: "tum" (`stamp tx ty tz qx qy qz qw`), or "json": with status and covariance, see `json_line`.

    Raises:
        ConfigError: Another format.
    """
    lines = {"tum": lambda result: tum_line(result.stamp, result.pose.mean).rstrip("\n"), "json": json_line}
    if format not in lines:
        raise ConfigError(f"the format of poses must be {' or '.join(lines)}, not '{format}'")
    return lines[format]


def json_line(result: FrameResult) -> str:
    """The pose world_T_camera as JSON: metres, quaternion x y z w, and rows of the covariance.

    The covariance (6, 6) is in the tangent of the pose, rotation first (rad), then translation (m), in camera axes.
    """
    rotation = result.pose.mean.rotation().toQuaternion()
    return json_text(
        {
            "frame": result.index,
            "stamp": result.stamp,
            "status": result.status,
            "position": result.pose.mean.translation(),
            "quaternion": [rotation.x(), rotation.y(), rotation.z(), rotation.w()],
            "covariance": result.pose.covariance,
        }
    )
