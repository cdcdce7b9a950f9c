"""P_f: what is made of odometry and visual SLAM at interleaved frames, and where odometry has gone since."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace

from fvslam_graph.core.frame_result import Ending
from fvslam_graph.core.gaussian_pose import GaussianPose, ScaledPose
from fvslam_graph.core.sequence import Frame
from fvslam_graph.core.slam_estimate import LandmarkObservations
from fvslam_graph.core.vo_estimate import CalibrationEvidence, OdometryMotion, OdometryStep
from fvslam_graph.fusion.odometry_chain import OdometryChain
from fvslam_graph.fusion.rules import FusionRule


class Fusion(ABC):
    """The reference P_f, from which both subsystems go on (the paper, section 3 and Fig. 1)."""

    def __init__(self) -> None:
        self._reference = ScaledPose.of(GaussianPose.identity())
        self._chain = OdometryChain()

    @property
    def reference(self) -> GaussianPose:
        """world_T_camera at the last frame where both were fused."""
        return self._reference.total

    @property
    def motion(self) -> OdometryMotion:
        """Motion since P_f, by odometry."""
        return self._chain.motion_in_scale

    @property
    def pose(self) -> GaussianPose:
        """world_T_camera of the newest frame: P_f, carried on by odometry."""
        return self._reference.compose(self._chain.motion).total

    def add_odometry(self, frame: Frame, step: OdometryStep) -> None:
        """Append the motion of a frame, O_f."""
        self._chain.add(frame.index, step)

    def start(self, pose: GaussianPose, observations: LandmarkObservations) -> None:
        """Visual SLAM begins at the newest frame, at this pose world_T_camera."""
        path = self._reference.compose(self._chain.motion)
        self._reference = replace(path, pose=replace(pose, covariance=pose.covariance - path.common))
        self._chain.anchor()

    def fuse(self, pose: GaussianPose, motion: GaussianPose, observations: LandmarkObservations | None) -> GaussianPose:
        """Make P_f of O_f and S_f, at the newest frame.

        Args:
            pose: world_T_camera by visual SLAM, S_f,
            motion: and the motion since the last P_f by it.
            observations: Landmarks in the frame; None where visual SLAM is lost.

        Returns:
            The motion since the last P_f.
        """
        fused = self._fused(pose, motion, observations)
        self._chain.anchor(fused)
        return fused

    def calibrate(self, evidence: CalibrationEvidence) -> None:
        """Take in what images say of the calibration of the file, if there is a variable for it."""
        return

    @property
    def enu(self) -> GaussianPose | None:
        """enu_T_camera of the newest frame; None where nothing tells it."""
        return None

    def finish(self) -> Ending | None:
        """What all frames together say; None where nothing is smoothed."""
        return None

    @abstractmethod
    def _fused(
        self, pose: GaussianPose, motion: GaussianPose, observations: LandmarkObservations | None
    ) -> GaussianPose:
        """Move the reference, and return by how much."""


class SlamAlone(Fusion):
    """Visual SLAM as it is; odometry carries on from there to frames on which it does not run."""

    def _fused(
        self, pose: GaussianPose, motion: GaussianPose, observations: LandmarkObservations | None
    ) -> GaussianPose:
        self._reference = ScaledPose.of(pose)
        return motion


class RuleFusion(Fusion):
    """Fuses by a rule that makes one motion of two; where visual SLAM is lost, odometry carries on alone.

    Args:
        rule: The mean, or covariance intersection.
    """

    def __init__(self, rule: FusionRule) -> None:
        super().__init__()
        self._rule = rule

    def _fused(
        self, pose: GaussianPose, motion: GaussianPose, observations: LandmarkObservations | None
    ) -> GaussianPose:
        odometry = self._chain.motion
        step = odometry if observations is None else odometry.replaced(self._rule(odometry.total, motion))
        self._reference = self._reference.compose(step)
        return step.total
