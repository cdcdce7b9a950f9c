"""The step that visual SLAM makes by an image, from its last state or from one before a loss."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam

from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.slam_estimate import LandmarkMatches
from fvslam_graph.slam.state import State


@dataclass(frozen=True)
class Remembered:
    """A state to go on from.

    Attributes:
        state: In the camera of its frame.
        map_T_camera: Of that camera, without the re-anchoring.
        index, stamp: Of its frame.
    """

    state: State
    map_T_camera: gtsam.Pose3
    index: int
    stamp: float


@dataclass(frozen=True)
class Sighting:
    """A state in a new camera.

    Attributes:
        state: With the landmarks of the earlier one.
        motion: From the earlier camera,
        previous: and the index of its frame.
        map_T_camera: Without the re-anchoring.
        matches: What became of the landmarks.
        lost: Whether too few of them agree, so that the motion is the predicted one.
    """

    state: State
    motion: GaussianPose
    previous: int
    map_T_camera: gtsam.Pose3
    matches: LandmarkMatches
    lost: bool
