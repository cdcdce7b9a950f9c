"""Whether a measured motion is believed, although the camera can hardly have moved so."""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.gates import chi2_gate
from fvslam_graph.core.gaussian_pose import GaussianPose

MAX_INNOVATION = 225.0  # squared deviations: accelerations have heavy tails, and jolts are not to be doubted,
AGREEMENT_GATE = chi2_gate(0.999, 6)  # but once in doubt, less
HARDLY_BELIEVED = 50.0  # beyond which a motion is believed, but leaves open that what was expected is right
INSISTENCE = 3  # implausible motions in a row that agree with each other: what the images insist on is believed
SCALES = np.linspace(-6, 6, 49)  # deviations of the logarithm of a scale, for which a motion is tried
AGED = 3.0  # standard deviations, within which a velocity has become so old that it allows for another one

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Measured:
    """A motion against the keyframe, which was not believed."""

    stamp: float
    pose: GaussianPose


@dataclass(frozen=True)
class _Doubt:
    """Two stories of how the camera moves, of which either may be right: that of the images, and the expected one.

    Attributes:
        start: Stamp where they part.
        twist: (6,) difference of their velocities, rad/s and m/s.
        seconds: After which forces may have made one velocity of the other, so that the first one tells nothing more.
    """

    start: float
    twist: Array
    seconds: float

    def covariance(self, stamp: float) -> Array:
        """(6, 6) of a mixture of both, each with probability one half, beyond what each has of its own."""
        apart = self.twist * float(np.clip(stamp - self.start, 0.0, self.seconds)) / 2
        return np.outer(apart, apart)


class MotionGate:
    """Holds measured motions against what the motion model expects.

    One that forces can hardly have brought about is not believed: images may come in the wrong order, freeze, or show
    something that moves itself. If they insist, the motion model may be wrong as well, and both are possible from then
    on, which the covariance says.
    """

    def __init__(self) -> None:
        self._refused: list[_Measured] = []  # in a row
        self._doubts: list[_Doubt] = []
        self._believed = 0.0  # stamp of the last motion that was
        self.insisted = False  # whether it was only since the images insisted

    def apply(
        self,
        measured: GaussianPose,
        expected: GaussianPose,
        stamp: float,
        start: float,
        accelerations: Array,
        log_variance: float = 0.0,
    ) -> GaussianPose | None:
        """The measured motion with a covariance that says how far it is to be believed; None where it is not.

        Args:
            measured: keyframe_T_cur of the images,
            expected: and of the motion model.
            stamp: Of the current image,
            start: and of the keyframe.
            accelerations: (6,) standard deviations, rad/s^2 and m/s^2.
            log_variance: Of the scale of the measured motion, which its covariance holds.
        """
        error, innovation = _difference(expected, measured, log_variance)
        self.insisted = False
        if innovation > (AGREEMENT_GATE if self._refused else MAX_INNOVATION):
            self._refused = [*self._refused[1 - INSISTENCE :], _Measured(stamp, measured)]
            if not self._insisted(accelerations):
                return None
            self.insisted = True
        if self.insisted or innovation > HARDLY_BELIEVED:
            twist = error / (stamp - self._believed)
            seconds = float(np.linalg.norm(twist / accelerations)) / AGED
            self._doubts.append(_Doubt(self._believed, twist, max(seconds, stamp - self._believed)))
        self.forget()
        self._believed = stamp
        self._doubts = [doubt for doubt in self._doubts if doubt.start + doubt.seconds > start]
        # What was open up to the keyframe is in its own pose.
        open_now = [doubt.covariance(stamp) - doubt.covariance(start) for doubt in self._doubts]
        return GaussianPose(measured.mean, measured.covariance + sum(open_now, np.zeros((6, 6))))

    def forget(self) -> None:
        """Forget what was refused: it was measured against a keyframe that is none any more."""
        self._refused = []

    def _insisted(self, accelerations: Array) -> bool:
        """Whether the motions that were refused go on from each other as those of one camera."""
        if len(self._refused) < INSISTENCE:
            return False
        first, second, third = self._refused[-3:]
        ahead, behind = third.stamp - second.stamp, second.stamp - first.stamp
        velocity = gtsam.Pose3.Logmap(first.pose.mean.between(second.pose.mean)) / behind
        sigmas = accelerations * (ahead + behind) / 2 * ahead
        expected = second.pose.compose(GaussianPose(gtsam.Pose3.Expmap(velocity * ahead), np.diag(sigmas**2)))
        return _difference(expected, third.pose)[1] < AGREEMENT_GATE


def _difference(expected: GaussianPose, measured: GaussianPose, log_variance: float = 0.0) -> tuple[Array, float]:
    """Difference of two poses, in the tangent (6,) of the measured one, and in squared deviations.

    These are the least that any length of the measured one has together with how unlikely this length is: a doubtful
    scale explains how far the camera went, and never that it went back.
    """
    error, travel = -gtsam.Pose3.Logmap(measured.mean.between(expected.mean)), measured.travel
    variance = measured.room_for_scale(log_variance)
    covariance = expected.covariance + measured.with_scale_variance(-variance).covariance
    both = np.column_stack([error, travel])
    (at_one, slope), (_, curvature) = both.T @ np.linalg.solve(covariance, both)
    if not variance > 0 or not curvature > 0:
        return error, float(at_one)
    nearest = max(1 - slope / curvature, 1e-9)  # by the poses alone
    scales = np.append(np.exp(math.sqrt(variance) * SCALES), nearest)
    squares = at_one + 2 * (scales - 1) * slope + (scales - 1) ** 2 * curvature
    return error, float((squares + np.log(scales) ** 2 / variance).min())
