"""The result of an estimator for each frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.slam_estimate import SlamEstimate
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.core.trajectory import Status, Trajectory

G2O, LANDMARKS_PLY, FACTORS, VALUES = "graph.g2o", "landmarks.ply", "graph.gtsam", "values.gtsam"


@dataclass(frozen=True)
class CalibrationEstimate:
    """What landmarks tell of the camera, after all that its file says.

    Attributes:
        focal_length: Pixels, along x.
        focal_sigma: Its standard deviation.
        k1: Radial distortion that is left in the images, as OpenCV's.
        k1_sigma: Its standard deviation.
    """

    focal_length: float
    focal_sigma: float
    k1: float
    k1_sigma: float


@dataclass(frozen=True)
class ClockEstimate:
    """How far the clock of a receiver is off.

    Attributes:
        offset: What is to be added to its stamps to have those of the images, seconds.
        sigma: Its standard deviation.
    """

    offset: float
    sigma: float


@dataclass(frozen=True)
class HeightEstimate:
    """How far the heights that were given are off.

    Attributes:
        factor: True over given heights.
        sigma: Its standard deviation.
    """

    factor: float
    sigma: float


@dataclass(frozen=True)
class EarthPlacement:
    """Where the world of a run is on Earth.

    Attributes:
        origin: (3,) latitude, longitude (degrees, WGS84) and altitude (m) of the place.
        enu_T_world: From the world to east, north, up at this place, metres; with its covariance.
        clock: How far that of the fixes is off.
        height: How far the height above the ground is; None where it is exact, or an altimeter's.
    """

    origin: NDArray[np.float64]
    enu_T_world: GaussianPose
    clock: ClockEstimate
    height: HeightEstimate | None = None


@dataclass(frozen=True)
class Ending:
    """What all frames together say, once the last one was seen.

    Attributes:
        smoothed: All poses, by all measurements; None where these do not determine them.
        summary: How many poses that is, or why there are none.
        calibration: The camera as the measurements tell it; None where they do not.
        write: Writes G2O, LANDMARKS_PLY, FACTORS and VALUES into a folder; raises an EstimationError without poses.
        placement: Of the smoothed poses on Earth; None where no fixes of a receiver tell it.
    """

    smoothed: Trajectory | None
    summary: str
    calibration: CalibrationEstimate | None
    write: Callable[[Path], None]
    placement: EarthPlacement | None = None


@dataclass(frozen=True)
class FrameResult:
    """The result of an estimator for one frame.

    Attributes:
        index: Position in the sequence, from 0; every frame has a result, in order.
        stamp: Seconds.
        pose: world_T_camera as known when the frame arrived.
        status: How the pose came about.
        previous: Index of the frame that `relative` starts from; `index` itself for the first frame.
        relative: prev_T_cur.
        measures: Columns of frames.csv, such as tracks, inliers, scale (m per unit baseline), scale_sigma.
        times: Milliseconds by stage. Measures and stages have the same names in every frame of a run.
        slam: What visual SLAM says, where it ran on this frame.
        enu: enu_T_camera, east, north, up from the first fix of a receiver; None before fixes tell it.
        tracks: The points that odometry's motion is by; none where odometry did not run.
    """

    index: int
    stamp: float
    pose: GaussianPose
    status: Status
    previous: int
    relative: GaussianPose
    measures: Mapping[str, float] = field(default_factory=dict)
    times: Mapping[str, float] = field(default_factory=dict)
    slam: SlamEstimate | None = None
    enu: GaussianPose | None = None
    tracks: Tracks = field(default_factory=Tracks.none)
