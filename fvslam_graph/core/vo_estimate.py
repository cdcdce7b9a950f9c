"""The estimate of visual odometry for a frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.gaussian_pose import GaussianPose, LogScale
from fvslam_graph.core.inverse_depths import MetricMap
from fvslam_graph.core.known_points import KnownPoints
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.core.trajectory import Status


@dataclass(frozen=True)
class ScaleStep:
    """Where the scale of a baseline comes from: what a filter of the scale, or a smoother, needs to know of one step.

    Attributes:
        length: What odometry makes of it all: log(metres) of the baseline.
        predicted: What the map says, in the scale that the last baseline had; the variance is what the step adds.
        measured: What the scale source says, with the variance of what is new in it; None where it does not speak.
        bias_variance: Variance of what the source errs likewise in neighbouring steps,
        bias_decay: and the share of this error that lasts to the next step.
        common_variance: Variance of what the source errs likewise in all steps.
        J_predicted: (2,) how what the map says changes with the logarithm of the focal length and with k1,
        J_measured: and how what the source says does.
        calibration: (2,) what was added to these two, of the images, in what the map says.
    """

    length: LogScale
    predicted: LogScale
    measured: LogScale | None = None
    bias_variance: float = 0.0
    bias_decay: float = 0.0
    common_variance: float = 0.0
    J_predicted: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    J_measured: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))
    calibration: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))


@dataclass(frozen=True)
class CalibrationEvidence:
    """What images say of the calibration that they were rectified with, whatever the motion was.

    Attributes:
        information: (P, P) of the logarithm of the focal length, of k1 and, as far as images were asked for these, of
            k2, principal point, p1 and p2,
        gradient: and (P,) of the log likelihood, where nothing is added to any.
    """

    information: NDArray[np.float64]
    gradient: NDArray[np.float64]


@dataclass(frozen=True)
class OdometryStep:
    """The motion of one frame by odometry, with all that fusion needs to know of it.

    Attributes:
        previous: Index of the frame that the motion starts from.
        prev_T_cur: The motion.
        scale: What was learnt of its scale; None where it has that of the map in the earlier frame.
        map_variance: Variance of the logarithm of the scale of the map; 0 without one.
        awaited: Frames besides this one and the previous one, against which motions to come may be measured.
        measured: Whether images tell it; a motion model's has no noise in common with others.
        J_calibration: (6, 2) how it changes with the logarithm of the focal length and with k1, in its tangent.
        calibration: (2,) what was added to these two of the file when it was measured.
    """

    previous: int
    prev_T_cur: GaussianPose
    scale: ScaleStep | None = None
    map_variance: float = 0.0
    awaited: tuple[int, ...] = ()
    measured: bool = True
    J_calibration: NDArray[np.float64] = field(default_factory=lambda: np.zeros((6, 2)))
    calibration: NDArray[np.float64] = field(default_factory=lambda: np.zeros(2))

    @cached_property
    def scale_variance(self) -> float:
        """How much of its covariance is due to the logarithm of the scale.

        The translation of a camera that turns hardly depends on the scale of the map, however doubtful this is.
        """
        return self.prev_T_cur.room_for_scale(self.map_variance)

    def longer(self, factor: float) -> OdometryStep:
        """The same with all lengths so many times as long."""
        J_calibration = np.repeat([1.0, factor], 3)[:, None] * self.J_calibration
        return replace(self, prev_T_cur=self.prev_T_cur.longer(factor), J_calibration=J_calibration)


@dataclass(frozen=True)
class OdometryMotion:
    """Where odometry has gone over some frames, apart from what its scale errs by.

    The error of the logarithm of its scale is a Markov chain: as far as the scale was measured meanwhile, it has
    nothing in common with what it was before.

    Attributes:
        pose: prev_T_cur, as certain as it is in this scale.
        J_scale: (6,) how it changes with the logarithm of the scale, in its tangent.
        scale_kept: Share of the scale's error at the beginning that is left at the end,
        scale_added: and the variance of what has come to it.
    """

    pose: GaussianPose
    J_scale: NDArray[np.float64]
    scale_kept: float
    scale_added: float

    @classmethod
    def of(cls, prev_T_cur: GaussianPose, variance: float) -> OdometryMotion:
        """A motion with all its uncertainty, in a scale whose logarithm has this variance, and that is new."""
        share = prev_T_cur.room_for_scale(variance) / variance if variance > 0 else 0.0
        return cls(prev_T_cur.with_scale_variance(-(share**2) * variance), share * prev_T_cur.travel, 0.0, variance)

    def longer(self, factor: float) -> OdometryMotion:
        """The same with all lengths so many times as long."""
        return replace(self, pose=self.pose.longer(factor), J_scale=np.repeat([1.0, factor], 3) * self.J_scale)


@dataclass(frozen=True)
class VoEstimate:
    """The motion of one frame.

    Attributes:
        index: Of the frame.
        previous: Index of the frame that the motion starts from: the keyframe at that time.
        prev_T_cur: Pose of this frame in that one.
        status: How it came about.
        found: How many points of the keyframe were found in this frame.
        tracks: Those that agree with the motion.
        scale: Of the baseline between the two, and where it comes from; None where none was estimated.
        map: What is known of the depths of these tracks in this frame.
        map_is_doubtful: Whether the map may be of the wrong one of two motions that explain a plane, so that nothing
            should be built on it.
        parallax: Median image motion that no rotation explains, pixels; NaN where not measured.
        scale_known: Whether its length is in the scale of the run (metres, or that of the first motion); else it is a
            guess.
        awaited: Indices of keyframes that were lost: a motion to come may start from one that is found again.
        J_calibration: (6, 2) how the motion changes with the logarithm of the focal length and with k1.
        evidence: What the two views say of these; None where the motion is not by two views.
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
    map_is_doubtful: bool = False
    parallax: float = math.nan
    scale_known: bool = True
    awaited: tuple[int, ...] = ()
    J_calibration: NDArray[np.float64] = field(default_factory=lambda: np.zeros((6, 2)))
    evidence: CalibrationEvidence | None = None
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
            self.J_calibration,
        )

    @property
    def points(self) -> KnownPoints:
        """The tracks of known depth, where they are in this frame."""
        depths = self.map.depths
        mine, theirs = depths.match(self.tracks.ids)
        return KnownPoints(
            depths.ids[mine],
            self.tracks.current[theirs],
            depths.values[mine],
            depths.sigmas[mine],
            depths.common[mine],
            self.map.variance,
        )
