"""Positions by a GNSS receiver in the graph: where the world is on Earth is one more variable."""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.sequence import Ground
from fvslam_graph.graph.alignment import align
from fvslam_graph.graph.factors import ENU, pose_key, robust
from fvslam_graph.graph.pending_update import PendingUpdate

Array = NDArray[np.float64]

MIN_SIGMA = 0.05  # metres; a receiver errs by that much beyond what it says, by its antenna and the clock
UP_SIGMA = 0.1  # rad, by which level ground departs from the horizon
UNKNOWN_UP_SIGMA = 1.0  # rad, where no ground is known: cameras are level rather than upside down
ALIGNMENT_SIGMAS = np.repeat([1.0, 1e3], 3)  # rad, m, of the first alignment: what a straight path leaves open is held


@dataclass(frozen=True)
class GraphFix:
    """A position as the graph takes it.

    Attributes:
        frame: The first one after it.
        enu: (3,) east, north, up, metres.
        sigmas: (3,) its standard deviations.
        lever: (3,) where the camera was at that time, in the camera at the frame, metres.
    """

    frame: int
    enu: Array
    sigmas: Array
    lever: Array


class Positions:
    """Makes factors of fixes, once they tell where the world is on Earth; until then they wait.

    Args:
        update: Collects factors and variables.
        settings: How robust.
        ground: Tells which way is up.

    Attributes:
        least_sigma: The least deviation of a position that was taken in, metres.
    """

    def __init__(self, update: PendingUpdate, settings: GraphSettings, ground: Ground | None = None) -> None:
        self._update, self._settings = update, settings
        self._up, self._up_sigma = np.array([0.0, -1.0, 0.0]), UNKNOWN_UP_SIGMA
        if ground is not None:
            self._up, self._up_sigma = -ground.normal, math.hypot(UP_SIGMA, ground.normal_sigma)
        self._waiting: list[GraphFix] = []
        self.least_sigma = math.inf
        self._tried = 0  # fixes that did not suffice

    def add(self, fix: GraphFix) -> None:
        """Take in a fix."""
        self._waiting.append(fix)

    def take(self, poses: list[gtsam.Pose3], world_T_enu: gtsam.Pose3 | None) -> bool:
        """Append the fixes that wait, if it is known where the world is.

        Args:
            poses: Of all frames, as known now.
            world_T_enu: Likewise; None before the graph has it.

        Returns:
            Whether there were any.
        """
        self._waiting = [fix for fix in self._waiting if self._update.has(pose_key(fix.frame))]  # not beyond the lag
        if world_T_enu is None:
            if len(self._waiting) == self._tried:
                return False
            self._tried = len(self._waiting)
            world_T_enu = self._begin(poses)
            if world_T_enu is None:
                return False
        for fix in self._waiting:
            rotation = world_T_enu.rotation().between(poses[fix.frame].rotation())
            self._update.add(enu_factor(fix, rotation, self._settings))
            self.least_sigma = min(self.least_sigma, max(float(fix.sigmas.min()), MIN_SIGMA))
        taken, self._waiting = bool(self._waiting), []
        return taken

    def _begin(self, poses: list[gtsam.Pose3]) -> gtsam.Pose3 | None:
        """The first alignment, as a variable with what is known of it besides the fixes."""
        fixes = self._waiting
        path = np.array([poses[fix.frame].transformFrom(fix.lever) for fix in fixes]).reshape(-1, 3)
        enu = np.array([fix.enu for fix in fixes]).reshape(-1, 3)
        sigmas = np.array([math.sqrt((fix.sigmas**2).mean()) for fix in fixes])
        enu_T_world = align(path, enu, np.maximum(sigmas, MIN_SIGMA), self._up, self._up_sigma)
        if enu_T_world is None:
            return None
        world_T_enu = enu_T_world.inverse()
        self._update.insert(ENU, world_T_enu)
        prior = gtsam.noiseModel.Diagonal.Sigmas(ALIGNMENT_SIGMAS)
        self._update.add(gtsam.PriorFactorPose3(ENU, world_T_enu, prior))
        level = gtsam.noiseModel.Isotropic.Sigma(2, self._up_sigma)
        self._update.add(gtsam.AttitudeFactorPose3(ENU, gtsam.Unit3(self._up), level, gtsam.Unit3(0.0, 0.0, 1.0)))
        return world_T_enu


def enu_factor(fix: GraphFix, enu_R_camera: gtsam.Rot3, settings: GraphSettings) -> gtsam.NonlinearFactor:
    """The camera's position east, north, up, at the time of a fix.

    It is a motion from the origin on Earth to the camera, of which only the position counts. What its rotation misses
    by, a few degrees as a rule, turns the lever alone, which is as long as the way between two frames.

    Args:
        fix: The position.
        enu_R_camera: About.
        settings: How robust.
    """
    seen = gtsam.Pose3(enu_R_camera, fix.enu - enu_R_camera.rotate(fix.lever))
    root = np.zeros((6, 6))
    at_lever = np.hstack([-gtsam.Rot3.Hat(fix.lever), np.eye(3)])
    root[:3] = enu_R_camera.matrix() @ at_lever / np.maximum(fix.sigmas, MIN_SIGMA)[:, None]
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(root, False)
    numbers = math.sqrt(3 / noise.dim())  # of the noise, half tell nothing
    return gtsam.BetweenFactorPose3(ENU, pose_key(fix.frame), seen, robust(noise, settings, numbers))
