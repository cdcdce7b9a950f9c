"""P_f by the factor graph."""

from __future__ import annotations

import math

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import GraphSettings, GroundSettings
from fvslam_graph.core.errors import EstimationError
from fvslam_graph.core.frame_result import CalibrationEstimate, EarthPlacement, Ending
from fvslam_graph.core.gaussian_pose import UNINFORMATIVE_VARIANCE, GaussianPose, ScaledPose
from fvslam_graph.core.geodesy import LocalFrame
from fvslam_graph.core.sequence import Frame, Ground
from fvslam_graph.core.slam_estimate import LandmarkObservations
from fvslam_graph.core.vo_estimate import CalibrationEvidence, OdometryStep
from fvslam_graph.fusion.fusion import Fusion
from fvslam_graph.graph.factor_graph import Graph

Array = NDArray[np.float64]

SAMPLES = 40  # positions, spread over the path, that tell in which scale it was published


class GraphFusion(Fusion):
    """All motions and landmarks in one graph, which is solved at interleaved frames.

    Args:
        camera: Undistorted.
        settings: Of the graph.
        ground: Below the camera, where its height is measured.
        relative: Nothing tells metres.
        roughness: Share of the height by which true ground departs from its plane, which a height measures, too.
    """

    def __init__(
        self,
        camera: Camera,
        settings: GraphSettings,
        ground: Ground | None,
        relative: bool = False,
        roughness: float = GroundSettings().roughness,
    ) -> None:
        super().__init__()
        self.graph = Graph(camera, settings, relative, ground)
        self._settings = settings
        self._down = ground.normal if ground is not None and settings.heights else None
        self._roughness = roughness
        self._earth: LocalFrame | None = None  # at the first fix
        self._enu: GaussianPose | None = None  # enu_T_camera at the last P_f
        self._newest = 0  # frame
        # Online poses of the newest frame and of the one that its motion starts from. Where this is before the last
        # P_f, what the motion to P_f erred about is not counted: the next motion does without it.
        self._poses: dict[int, GaussianPose] = {}
        self._earlier = 0, np.zeros(3)  # where motions started before the last P_f, and metres by which it moved
        # Where P_f was, at each interleaved frame, and the camera in each one before there were landmarks; and whether
        # that was in a scale that was known.
        self._published: dict[int, Array] = {}
        self._started, self._scaled, self._relative = False, True, relative
        self._origin = np.zeros(3)  # where the origin of the graph is in what is published, metres
        # Of the steps by which P_f corrected the path: what online poses have not taken up yet (m, in the world), and
        # which share of it is left a frame later.
        self._step, self._left = np.zeros(3), 0.0

    def add_odometry(self, frame: Frame, step: OdometryStep) -> None:
        """Append the motion of a frame, its fixes, and height above level ground and gravity, if these are given."""
        super().add_odometry(frame, step)
        self._newest = frame.index
        self._step = self._left * self._step
        self.graph.add_odometry(frame.stamp, step)
        start = self._poses.get(step.previous) or self._earlier_pose(step.previous)
        if start is None:  # beyond the lag, or the first frame
            self._poses = {frame.index: super().pose}
        else:
            self._poses = {step.previous: start, frame.index: start.compose(step.prev_T_cur)}
        if not self._started:
            self._scaled &= self._relative or step.map_variance < UNINFORMATIVE_VARIANCE
            self._published[frame.index] = self._poses[frame.index].mean.translation()
        if self._down is not None and frame.height > 0:
            sigma = math.hypot(frame.height_sigma, self._roughness * frame.height)
            self.graph.add_height(frame.height, sigma, self._down)
        if frame.gravity is not None:
            self.graph.add_gravity(frame.gravity)
        for fix in frame.fixes:
            self._earth = self._earth or LocalFrame(fix.place)
            self.graph.add_position(fix.stamp, self._earth.enu(fix.place[None])[0], fix.sigmas)

    @property
    def pose(self) -> GaussianPose:
        """world_T_camera of the newest frame: carried on by odometry from the frame that its motion starts from.

        What the graph corrects at once, the online path takes up over about an interval, so that it does not jump.
        """
        return _moved(self._poses[self._newest], self._step)

    @property
    def enu(self) -> GaussianPose | None:
        """Where the graph has the camera on Earth, carried on by odometry since the last P_f."""
        return None if self._enu is None else self._enu.compose(self._chain.motion.total)

    def start(self, pose: GaussianPose, observations: LandmarkObservations) -> None:
        """Landmarks begin at the newest frame.

        What was published in a scale that was a guess says nothing of the scale of the path: it goes on from its end.
        """
        super().start(pose, observations)
        self.graph.fuse(observations)
        self._published.pop(self._newest, None)
        if not self._started and not self._scaled:
            self._published.clear()
            here = self._poses[self._newest].mean.translation()
            self._origin = here - self.graph.positions([self._newest])[0]
        self._started = True
        self._publish()

    def _fused(
        self, pose: GaussianPose, motion: GaussianPose, observations: LandmarkObservations | None
    ) -> GaussianPose:
        fused = self.graph.fuse(observations)
        self._publish()
        return self._chain.motion.total if fused is None else fused

    def _publish(self) -> None:
        """Move the reference to where the graph has the camera, but for what is published of the path behind it."""
        before = next(reversed(self._published), None)
        expected = self._poses[self._newest].mean.translation()
        away = np.zeros(3)
        if self._settings.online == "continuous" and before is not None:
            # What lies behind the last P_f in the scale in which it was published, the motion since in that of now.
            away = (self._published_scale() - 1) * self.graph.positions([before])[0]
        away = away + self._origin
        self._earlier = min(self._poses), away
        self._poses = {self._newest: _moved(self.graph.pose(self._newest), away)}
        self._reference = ScaledPose.of(self._poses[self._newest])
        if self._settings.online == "continuous" and before is not None:
            self._left = math.exp(-1 / (self._newest - before))
            self._step = self._step + self._left * (expected - self.reference.mean.translation())
        self._published[self._newest] = self.reference.mean.translation() - self._origin
        self._enu = self.graph.enu_T_camera(self._newest)

    def _earlier_pose(self, frame: int) -> GaussianPose | None:
        """The online pose of the frame where motions started before the last P_f; None of others or beyond the lag."""
        earlier, away = self._earlier
        return _moved(self.graph.pose(frame), away) if frame == earlier and self.graph.has(frame) else None

    def calibrate(self, evidence: CalibrationEvidence) -> None:
        """Add what images say of the calibration of the file."""
        self.graph.add_calibration(evidence)

    def finish(self) -> Ending:
        """All poses by all measurements, as far as these determine them."""
        graph = self.graph
        try:
            smoothed = graph.smoothed()
        except EstimationError as error:
            return Ending(None, f"not determined: {error}", None, graph.write)
        summary, placement = f"{len(smoothed)} of {graph.frames} poses", self._placement()
        return Ending(smoothed, summary, self._calibration(), graph.write, placement)

    def _placement(self) -> EarthPlacement | None:
        try:
            enu_T_world, clock, height = self.graph.enu_T_world(), self.graph.clock, self.graph.height
        except (EstimationError, RuntimeError):  # as which GTSAM's exceptions arrive
            return None
        if self._earth is None or enu_T_world is None or clock is None:
            return None
        return EarthPlacement(self._earth.origin, enu_T_world, clock, height)

    def _calibration(self) -> CalibrationEstimate | None:
        try:
            return self.graph.calibration
        except (EstimationError, RuntimeError):  # as which GTSAM's exceptions arrive
            return None

    def _published_scale(self) -> float:
        """The scale in which the path was published, against that in which the graph has it now, by least squares."""
        frames = list(self._published)[:: -(-len(self._published) // SAMPLES)]
        own, published = self.graph.positions(frames), np.array([self._published[frame] for frame in frames])
        square, product = float((own**2).sum()), float((published * own).sum())
        return product / square if square > 0 and product > 0 else 1.0


def _moved(pose: GaussianPose, away: Array) -> GaussianPose:
    """A pose (3,) metres away from where it is believed to be, with its mean squared error by this belief."""
    rotation = pose.mean.rotation()
    error = np.concatenate([np.zeros(3), rotation.unrotate(away)])
    moved = gtsam.Pose3(rotation, pose.mean.translation() + away)
    return GaussianPose(moved, pose.covariance + np.outer(error, error))
