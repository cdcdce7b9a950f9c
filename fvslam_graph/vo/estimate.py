"""What visual odometry says about a frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.estimates import GaussianPose, LogScale, OdometryStep, ScaleStep
from fvslam_graph.features.known_points import KnownPoints
from fvslam_graph.features.tracks import Tracks
from fvslam_graph.trajectory import Status
from fvslam_graph.vo.scale import MetricMap
from fvslam_graph.vo.two_view import TwoView


@dataclass(frozen=True)
class VoEstimate:
    """The motion of one frame.

    Attributes:
        index: Of the frame.
        previous: Index of the frame that the motion starts from: the reference (keyframe) at that time.
        prev_T_cur: Pose of this frame in that one.
        status: How it came about.
        found: How many points of the reference were found in this frame.
        tracks: Those that agree with the motion.
        scale: Of the baseline between the two, and where it comes from; None where none was estimated.
        map: What is known of the depths of these tracks in this frame.
        parallax: Median image motion that no rotation explains, pixels; NaN where not measured.
        awaited: Indices of references that were lost: a motion to come may start from one that is found again.
        by_calibration: (6, 2) how the motion changes with the logarithm of the focal length and with k1.
        times: Milliseconds by stage.
    """

    index: int
    previous: int
    prev_T_cur: GaussianPose
    status: Status
    found: int = 0
    tracks: Tracks = field(default_factory=Tracks.none)
    scale: ScaleStep | None = None
    map: MetricMap = field(default_factory=MetricMap.empty)
    parallax: float = math.nan
    awaited: tuple[int, ...] = ()
    by_calibration: NDArray[np.float64] = field(default_factory=lambda: np.zeros((6, 2)))
    times: dict[str, float] = field(default_factory=dict)

    @property
    def step(self) -> OdometryStep:
        """The motion, for fusion."""
        measured = self.status in (Status.TRACKED, Status.STATIC)
        return OdometryStep(
            self.previous,
            self.prev_T_cur,
            self.scale,
            self.map.variance,
            self.awaited,
            measured,
            self.by_calibration,
        )

    @property
    def points(self) -> KnownPoints:
        """The tracks of known depth, where they are in this frame."""
        depths = self.map.depths
        mine, theirs = depths.common(self.tracks.ids)
        return KnownPoints(
            depths.ids[mine],
            self.tracks.current[theirs],
            depths.values[mine],
            depths.sigmas[mine],
            depths.shared[mine],
            self.map.variance,
        )


def metric_pose(two_view: TwoView, scale: LogScale) -> GaussianPose:
    """The pose prev_T_cur of two views with a scale.

    Its covariance holds what two views tell, and the scale along the baseline.
    """
    jacobian = metric_jacobian(two_view, scale)
    measured = np.zeros((6, 6))
    measured[:5, :5] = two_view.covariance
    measured[5, 5] = scale.variance
    covariance: NDArray[np.float64] = jacobian @ measured @ jacobian.T
    prev_T_cur = gtsam.Pose3(two_view.rotation, scale.metres * two_view.direction)
    return GaussianPose(prev_T_cur, (covariance + covariance.T) / 2)


def metric_jacobian(two_view: TwoView, scale: LogScale) -> NDArray[np.float64]:
    """How the pose changes with what two views tell, and with the logarithm of the scale, (6, 6)."""
    cur_R_prev = two_view.rotation.matrix().T
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = np.eye(3)
    jacobian[3:, 3:5] = scale.metres * cur_R_prev @ gtsam.Unit3(two_view.direction).basis()
    jacobian[3:, 5] = scale.metres * cur_R_prev @ two_view.direction
    return jacobian
