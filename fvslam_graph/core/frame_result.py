"""The result of an estimator for each frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.slam_estimate import SlamEstimate
from fvslam_graph.core.trajectory import Status, Trajectory

G2O, LANDMARKS_PLY, FACTORS, VALUES = "graph.g2o", "landmarks.ply", "graph.gtsam", "values.gtsam"


class SmoothedGraph(Protocol):
    """A factor graph of a whole run, as far as its results are about it."""

    @property
    def frames(self) -> int:
        """How many there are."""

    @property
    def calibration(self) -> Any:
        """The camera as landmarks tell it, a dataclass; None where they do not."""

    def smoothed(self) -> Trajectory:
        """All poses, by all measurements; raises an EstimationError where these do not determine them."""

    def write(self, folder: Path) -> None:
        """Write G2O, LANDMARKS_PLY, FACTORS and VALUES into a folder."""


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
        graph: The factor graph, where the mode has one: the same object in every result, which goes on to grow.
    """

    index: int
    stamp: float
    pose: GaussianPose
    status: Status
    previous: int
    relative: GaussianPose
    measures: Mapping[str, float]
    times: Mapping[str, float]
    slam: SlamEstimate | None = None
    graph: SmoothedGraph | None = None
