"""P_f by the factor graph."""

from __future__ import annotations

from fvslam_graph.camera import Camera
from fvslam_graph.config import GraphSettings
from fvslam_graph.estimates import GaussianPose, ScaleStep, Views
from fvslam_graph.fusion.fusion import Fusion
from fvslam_graph.fusion.graph import Graph
from fvslam_graph.sequences.base import Frame, Ground


class GraphFusion(Fusion):
    """All motions and landmarks in one graph, which is solved at interleaved frames.

    Args:
        camera: Undistorted.
        settings: Of the graph.
        ground: Below the camera, where its height is measured.
    """

    def __init__(self, camera: Camera, settings: GraphSettings, ground: Ground | None) -> None:
        super().__init__()
        self.graph: Graph = Graph(camera, settings)
        self._settings = settings
        self._down = ground.normal if ground is not None and settings.heights else None

    def add_odometry(
        self, frame: Frame, previous: int, prev_T_cur: GaussianPose, scale: ScaleStep | None, scale_variance: float
    ) -> None:
        """The motion of a frame, and the height above level ground, if this is asked for."""
        super().add_odometry(frame, previous, prev_T_cur, scale, scale_variance)
        self.graph.add_odometry(frame.stamp, previous, prev_T_cur, scale, scale_variance)
        if self._down is not None and frame.height > 0:
            self.graph.add_height(frame.height, frame.height_sigma, self._down)

    def start(self, pose: GaussianPose, views: Views) -> None:
        """Landmarks begin at the newest frame."""
        super().start(pose, views)
        self.graph.fuse(views)

    def _fused(self, pose: GaussianPose, motion: GaussianPose, views: Views | None) -> GaussianPose:
        fused = self.graph.fuse(views)
        moved = self.reference.mean.compose(fused.mean)
        self.reference = self.graph.pose if self._settings.online == "pose" else self.graph.judged(moved)
        return fused
