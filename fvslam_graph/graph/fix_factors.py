"""A fix of a GNSS receiver as factors: the camera's place on Earth at a time that the receiver's clock tells."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.config import GraphSettings
from fvslam_graph.graph.calibration import EXACT_SIGMA, TAILS
from fvslam_graph.graph.factors import CLOCK, ENU, pose_key, robust

Array = NDArray[np.float64]

MIN_SIGMA = 0.05  # metres; a receiver errs by that much beyond what it says, by its antenna
ADDED = 1e-3  # of a fix's variance, for being told in two steps: what is exact, solvers do not like
ROTATION_SIGMA = 1e-3  # rad, of the camera at the time of a fix, which says nothing of it


@dataclass(frozen=True)
class GraphFix:
    """A position as the graph takes it.

    Attributes:
        stamp: Seconds, by the receiver's clock.
        enu: (3,) east, north, up, metres.
        sigmas: (3,) its standard deviations.
    """

    stamp: float
    enu: Array
    sigmas: Array


@dataclass(frozen=True)
class Moment:
    """Where the camera was at a time between two frames, as it moves evenly from one to the other.

    Attributes:
        frame: The later one.
        stamp: Of that frame, seconds.
        frame_T_camera: Where it was.
        twist: (6,) how it moved there, rotation first, per second.
    """

    frame: int
    stamp: float
    frame_T_camera: gtsam.Pose3
    twist: Array


@dataclass(frozen=True)
class KnownPath:
    """Where the camera was, as known now.

    Attributes:
        stamps: Of all frames, seconds.
        pose: world_T_camera of a frame.
    """

    stamps: list[float]
    pose: Callable[[int], gtsam.Pose3]

    def at(self, time: float) -> Moment | None:
        """Where it was at a time; None where no frame is near, as before the first or not yet."""
        if len(self.stamps) < 2:
            return None
        frame = min(max(bisect_left(self.stamps, time), 1), len(self.stamps) - 1)
        step = self.stamps[frame] - self.stamps[frame - 1]
        since = time - self.stamps[frame]
        if not -2 * step <= since <= step:  # beyond either end, it moves on as it did for the time of one step
            return None
        twist = gtsam.Pose3.Logmap(self.pose(frame - 1).between(self.pose(frame))) / step
        return Moment(frame, self.stamps[frame], gtsam.Pose3.Expmap(since * twist), twist)


def clock_prior(settings: GraphSettings) -> gtsam.NonlinearFactor:
    """The prior of the offset, by clocks that are right as a rule, and if they are not, may be off by far."""
    noise = gtsam.noiseModel.Isotropic.Sigma(1, max(settings.clock_sigma, EXACT_SIGMA))
    tails = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(TAILS), noise)
    return gtsam.PriorFactorDouble(CLOCK, 0.0, tails)


def place_factor(key: int, fix: GraphFix, enu_R_camera: gtsam.Rot3, settings: GraphSettings) -> gtsam.NonlinearFactor:
    """The camera's position east, north, up.

    It is a motion from the origin on Earth to the camera, of which only the position counts.

    Args:
        key: Of the camera's pose.
        fix: The position.
        enu_R_camera: About.
        settings: How robust.
    """
    root = np.zeros((6, 6))
    root[:3, 3:] = enu_R_camera.matrix() / np.maximum(fix.sigmas, MIN_SIGMA)[:, None]
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(root, False)
    numbers = math.sqrt(3 / noise.dim())  # of the noise, half tell nothing
    return gtsam.BetweenFactorPose3(ENU, key, gtsam.Pose3(enu_R_camera, fix.enu), robust(noise, settings, numbers))


def moment_factor(key: int, moment: Moment, offset: float, start: gtsam.Pose3, sigma: float) -> gtsam.NonlinearFactor:
    """The camera's pose at the time of a fix, by that of a frame and the clock's offset, in which it is linear.

    Whatever the frame moves by, it moves along: x_k Exp(d) M = x_k M Exp(Ad(M^-1) d).

    Args:
        key: Of this pose.
        moment: Where it is, if the clock is off by
        offset: Seconds.
        start: Where the pose of the frame is linearised.
        sigma: Of the fix, metres, of which a share is added.
    """
    values = gtsam.Values()
    values.insert(key, start.compose(moment.frame_T_camera))
    values.insert(pose_key(moment.frame), start)
    values.insert(CLOCK, offset)
    tight = np.diag(1 / np.repeat([ROTATION_SIGMA, math.sqrt(ADDED) * sigma], 3))
    along = tight @ moment.frame_T_camera.inverse().AdjointMap()
    unit = gtsam.noiseModel.Unit.Create(6)
    linear = gtsam.JacobianFactor(
        key, tight, pose_key(moment.frame), -along, CLOCK, -tight @ moment.twist[:, None], np.zeros(6), unit
    )
    return gtsam.LinearContainerFactor(linear, values)
