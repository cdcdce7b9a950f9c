"""Positions by a GNSS receiver in the graph: where the world is on Earth is one more variable, and so is its clock."""

from __future__ import annotations

import math
from collections.abc import Sequence

import gtsam
import numpy as np

from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.sequence import Ground
from fvslam_graph.graph.alignment import align
from fvslam_graph.graph.factors import CLOCK, ENU, fix_key, pose_key
from fvslam_graph.graph.fix_factors import (
    MIN_SIGMA,
    GraphFix,
    KnownPath,
    Moment,
    clock_prior,
    moment_factor,
    place_factor,
)
from fvslam_graph.graph.pending_update import PendingUpdate

MAX_CLOCK_SHIFT = 0.05  # seconds, about which a camera moves evenly
UP_SIGMA = 0.1  # rad, by which level ground departs from the horizon
UNKNOWN_UP_SIGMA = 1.0  # rad, where no ground is known: cameras are level rather than upside down
ALIGNMENT_SIGMAS = np.repeat([1.0, 1e3], 3)  # rad, m, of the first alignment: what a straight path leaves open is held


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
        self._taken: list[tuple[GraphFix, float]] = []  # with the offset of the clock by which it was

    def add(self, fix: GraphFix) -> None:
        """Take in a fix."""
        self._waiting.append(fix)

    def take(self, path: KnownPath, world_T_enu: gtsam.Pose3 | None, offset: float) -> bool:
        """Append the fixes that wait, if it is known where the world is, and the path reaches to their time.

        Args:
            path: With the frames of the update.
            world_T_enu: As known now; None before the graph has it.
            offset: Of the clock, seconds, likewise.

        Returns:
            Whether there were any.
        """
        if world_T_enu is None and len(self._waiting) == self._tried:
            return False
        moments = [(fix, path.at(fix.stamp + offset)) for fix in self._waiting]
        early = [fix for fix, moment in moments if moment is None]
        known = [(fix, moment) for fix, moment in moments if moment is not None and self._within(moment)]
        if world_T_enu is None:
            self._waiting = early + [fix for fix, _ in known]
            self._tried = len(self._waiting)
            world_T_enu = self._begin(known, path)
            if world_T_enu is None:
                return False
        for fix, moment in known:
            self._append(fix, moment, offset, world_T_enu)
        self._waiting = early
        return bool(known)

    def release(self, offset: float) -> set[int]:
        """Have all fixes wait again, if some were taken in by a clock whose offset was another one, seconds.

        Returns:
            The keys of all of them, which are to be forgotten.
        """
        if all(abs(offset - before) < MAX_CLOCK_SHIFT for _, before in self._taken):
            return set()
        keys = set(map(fix_key, range(len(self._taken))))
        self._waiting = [fix for fix, _ in self._taken] + self._waiting
        self._taken = []
        return keys

    def _within(self, moment: Moment) -> bool:
        """Whether the frames on both sides are not beyond the lag."""
        return self._update.has(pose_key(moment.frame)) and self._update.has(pose_key(moment.frame - 1))

    def _append(self, fix: GraphFix, moment: Moment, offset: float, world_T_enu: gtsam.Pose3) -> None:
        key, frame = fix_key(len(self._taken)), pose_key(moment.frame)
        start = self._update.linearised(frame)
        there = start.compose(moment.frame_T_camera)
        sigma = max(float(fix.sigmas.min()), MIN_SIGMA)
        self._update.insert(key, there)
        self._update.stamps[key] = moment.stamp
        self._update.add(place_factor(key, fix, world_T_enu.rotation().between(there.rotation()), self._settings))
        self._update.add(moment_factor(key, moment, offset, start, sigma))
        self._taken.append((fix, offset))
        self.least_sigma = min(self.least_sigma, sigma)

    def _begin(self, known: Sequence[tuple[GraphFix, Moment]], path: KnownPath) -> gtsam.Pose3 | None:
        """The first alignment, as a variable with what is known of it besides the fixes; and the clock."""
        at = [path.pose(moment.frame).transformFrom(moment.frame_T_camera.translation()) for _, moment in known]
        enu = np.array([fix.enu for fix, _ in known]).reshape(-1, 3)
        sigmas = np.array([math.sqrt((fix.sigmas**2).mean()) for fix, _ in known])
        up, up_sigma = self._up, self._up_sigma
        enu_T_world = align(np.array(at).reshape(-1, 3), enu, np.maximum(sigmas, MIN_SIGMA), up, up_sigma)
        if enu_T_world is None:
            return None
        world_T_enu = enu_T_world.inverse()
        self._update.insert(ENU, world_T_enu)
        prior = gtsam.noiseModel.Diagonal.Sigmas(ALIGNMENT_SIGMAS)
        self._update.add(gtsam.PriorFactorPose3(ENU, world_T_enu, prior))
        level = gtsam.noiseModel.Isotropic.Sigma(2, up_sigma)
        self._update.add(gtsam.AttitudeFactorPose3(ENU, gtsam.Unit3(up), level, gtsam.Unit3(0.0, 0.0, 1.0)))
        self._update.insert(CLOCK, 0.0)
        self._update.add(clock_prior(self._settings))
        return world_T_enu
