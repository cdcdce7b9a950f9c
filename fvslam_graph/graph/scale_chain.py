"""The scale of odometry as variables of the graph: the common error of its lengths."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.gaussian_pose import UNINFORMATIVE_VARIANCE, GaussianPose, LogScale
from fvslam_graph.core.vo_estimate import OdometryStep, ScaleStep
from fvslam_graph.graph.calibration import CALIBRATION, SelfCalibration
from fvslam_graph.graph.factors import HEIGHT, SHORT, pose_key
from fvslam_graph.graph.pending_update import PendingUpdate

Array = NDArray[np.float64]

LENGTH_SIGMA = 1e-4  # share of a length that it errs by, beyond its scale
CONVENTION = 1e-3  # of the logarithm of a scale that nothing measures
KNOWN = 1e-4  # likewise, of one that the graph has, while new ones are settled


def scale_key(frame: int) -> int:
    """The key of the logarithm of true over measured lengths, as odometry learns it at a frame."""
    return int(gtsam.symbol("s", frame))


def bias_key(frame: int) -> int:
    """The key of the scale source's bias at a frame and at those around it, in the logarithm of the scale."""
    return int(gtsam.symbol("b", frame))


@dataclass(frozen=True)
class _Length:
    """How long a motion is: `metres`, if the variable `scale` were as `expected`."""

    metres: float
    sigma: float
    scale: int
    expected: float


class ScaleChain:
    """Odometry's filter of the scale as a chain in the graph, which smooths it together with all else.

    Lengths of consecutive motions are not independent: all have the scale that the map carries. What the map says of a
    step links the scales of two keyframes; what the scale source says holds one of them, up to an error that
    neighbouring steps share (first-order Gauss-Markov, as in `vo.scale_filter`), about one that all have: that of the
    height. Positions from outside tell it.

    All factors are GTSAM's own; those that it has no class for are linear ones (LinearContainerFactor).

    Args:
        update: Collects factors and variables.
        calibration: The camera's, as a variable; where there is none, that of the file holds.
        relative: Nothing tells metres. Then the first scale is a convention: one that is merely not known would shrink
            the path to a point, where what errs by metres errs by none.
    """

    def __init__(
        self, update: PendingUpdate, calibration: SelfCalibration | None = None, relative: bool = False
    ) -> None:
        self._update, self._calibration, self._relative = update, calibration, relative
        self._scale_of: dict[int, int] = {}  # frame where the scale was learnt that another frame's map has
        self._lengths: dict[tuple[int, int], _Length] = {}  # of the motions between two frames
        self._new = gtsam.NonlinearFactorGraph()  # factors of scales alone, since they were settled last

    def extend(self, index: int, motion: OdometryStep) -> list[int]:
        """Tell where the scale of the motion that leads to a frame comes from.

        Returns:
            The variables that this is about, that of the motion's own scale first.
        """
        previous, step = motion.previous, motion.scale
        before = self._scale_of.get(previous)
        beyond_lag = before is not None and not self._update.has(scale_key(before))
        if before is not None and step is None and not beyond_lag:
            self._scale_of[index] = before
            return self._variables(before)
        self._scale_of[index] = index
        self._update.insert(scale_key(index), 0.0)
        if step is None or beyond_lag:  # all that odometry made of it
            self._begin(scale_key(index), LogScale(0.0, motion.scale_variance))
            return [scale_key(index)]
        self._scale_of[previous] = index  # from now on: motions that follow from there have the scale of its map
        predicted = LogScale(step.predicted.mean - step.length.mean, step.predicted.variance)
        if before is None or (self._relative and predicted.variance >= UNINFORMATIVE_VARIANCE):
            self._begin(scale_key(index), predicted)
        else:
            self._link(
                scale_key(before), scale_key(index), predicted, step.J_predicted, motion.calibration + step.calibration
            )
        if step.bias_variance > 0:
            self._update.insert(bias_key(index), 0.0)
            if step.common_variance > 0 and not self._update.has(HEIGHT):
                self._update.insert(HEIGHT, 0.0)
                self._hold(HEIGHT, LogScale(0.0, step.common_variance))
            self._bias(None if before is None else bias_key(before), bias_key(index), step)
        if step.measured is not None:
            measured = LogScale(step.measured.mean - step.length.mean, step.measured.variance)
            if step.bias_variance > 0:
                self._link(bias_key(index), scale_key(index), measured, step.J_measured, motion.calibration)
            else:
                self._hold(scale_key(index), measured)
        return self._variables(index) + ([] if before is None else self._variables(before))

    def settle(self) -> None:
        """Begin new scales where they most likely are, by what they are linked to and what was measured of them.

        Lengths are linear in the logarithm of the scale. A path that began without metres may be many times too long.
        """
        factors, self._new = self._new, gtsam.NonlinearFactorGraph()
        start = gtsam.Values()
        for key in factors.keyVector():
            start.insert(key, self.expected(key))
            if not self._update.values.exists(key):
                factors.add(gtsam.PriorFactorDouble(key, start.atDouble(key), _sigma(KNOWN**2)))
        settled = start.retract(factors.linearize(start).optimize())
        for key in filter(self._update.values.exists, settled.keys()):
            self._update.values.update(key, settled.atDouble(key))

    def expected(self, key: int) -> float:
        """A variable as known now: a new one after `settle`."""
        values = self._update.values
        return values.atDouble(key) if values.exists(key) else self._update.solver.number(key)

    def measure(
        self, previous: int, index: int, scale: int, motion: GaussianPose, world_T_previous: gtsam.Pose3
    ) -> bool:
        """Tell how long a motion is, after `settle`.

        Args:
            previous, index: The motion goes from one frame to the other.
            scale: The variable of its scale.
            motion: As long as by the scale that is expected, without the variance of this.
            world_T_previous: Where it begins, as known now.

        Returns:
            Whether it is long enough to have a length.
        """
        metres = float(np.linalg.norm(motion.mean.translation()))
        if metres < SHORT:
            return False
        direction = motion.mean.translation() / metres
        travel = motion.mean.rotation().unrotate(direction)
        translation = motion.covariance[3:, 3:]
        along = float(travel @ translation @ travel)
        across = float(np.trace(translation)) - along
        # Of a direction that errs by an angle, the length along the mean is less by half of the square of that.
        variance = along + (across / metres) ** 2 / 2 + (LENGTH_SIGMA * metres) ** 2
        length = _Length(metres, math.sqrt(variance), scale, self.expected(scale))
        self._lengths[previous, index] = length
        self._update.add(_length_factor(previous, index, length, direction, motion.mean, world_T_previous))
        return True

    def lengths(self, values: gtsam.Values) -> dict[tuple[int, int], tuple[float, float]]:
        """Length and its deviation (m) of the motions between two frames, with the scale that the graph has found."""
        found = {}
        for frames, length in self._lengths.items():
            if values.exists(length.scale):
                ratio = 1 + values.atDouble(length.scale) - length.expected
                found[frames] = (length.metres * ratio, length.sigma)
        return found

    def forget(self) -> None:
        """Drop what refers to variables that the graph no longer has."""
        self._scale_of = {frame: scale for frame, scale in self._scale_of.items() if self._update.has(scale_key(scale))}
        self._lengths = {frames: length for frames, length in self._lengths.items() if self._update.has(length.scale)}

    def _variables(self, frame: int) -> list[int]:
        return [key for key in (scale_key(frame), bias_key(frame)) if self._update.has(key)]

    def _begin(self, key: int, value: LogScale) -> None:
        """The first scale of a chain, or of what is left of it."""
        self._hold(key, LogScale(value.mean, CONVENTION**2) if self._relative else value)

    def _hold(self, key: int, value: LogScale) -> None:
        self._add(gtsam.PriorFactorDouble(key, value.mean, _sigma(value.variance)))

    def _link(self, first: int, second: int, difference: LogScale, J_calibration: Array, applied: Array) -> None:
        """How much larger the second is than the first, which changes with the calibration.

        New depths err otherwise than old ones by what is wrong with it: so the scale that a map carries through a turn
        drifts, and the drift tells the calibration.

        Args:
            first, second: Keys.
            difference: By a calibration to which `applied` (2,) was added, in the logarithm of the focal length and k1.
            J_calibration: (2,) how its mean changes with both.
        """
        calibration, noise = self._calibration, _sigma(difference.variance)
        if calibration is None or not J_calibration.any() or not self._update.has(CALIBRATION):
            self._add(gtsam.BetweenFactorDouble(first, second, difference.mean, noise))
            return
        known = calibration.step(self._update.calibration())
        mean = difference.mean + float(J_calibration @ (known - applied))
        self._new.add(gtsam.BetweenFactorDouble(first, second, mean, noise))
        jacobians = (
            (first, -np.eye(1)),
            (second, np.eye(1)),
            (CALIBRATION, -J_calibration[None] @ calibration.jacobian()),
        )
        about_file = np.array([difference.mean - float(J_calibration @ applied)])
        values = gtsam.Values()
        values.insert(first, 0.0)
        values.insert(second, 0.0)
        values.insert(CALIBRATION, calibration.start)
        linear = gtsam.JacobianFactor(*chain.from_iterable(jacobians), about_file, noise)
        self._update.add(gtsam.LinearContainerFactor(linear, values))

    def _bias(self, before: int | None, key: int, step: ScaleStep) -> None:
        """A bias begins, or goes on from the one before: it decays to what all measurements err by."""
        decay, terms = 0.0, {key: 1.0}
        if before is not None and self._update.has(before):
            decay = step.bias_decay
            terms[before] = -decay
        if self._update.has(HEIGHT):
            terms[HEIGHT] = decay - 1
        values = gtsam.Values()
        for variable in terms:
            values.insert(variable, 0.0)
        jacobians = ((variable, np.array([[share]])) for variable, share in terms.items())
        noise = _sigma((1 - decay**2) * step.bias_variance)
        linear = gtsam.JacobianFactor(*chain.from_iterable(jacobians), np.zeros(1), noise)
        self._add(gtsam.LinearContainerFactor(linear, values))

    def _add(self, factor: gtsam.NonlinearFactor) -> None:
        self._new.add(factor)
        self._update.add(factor)


def _length_factor(
    previous: int,
    index: int,
    length: _Length,
    direction: NDArray[np.float64],
    prev_T_cur: gtsam.Pose3,
    world_T_previous: gtsam.Pose3,
) -> gtsam.NonlinearFactor:
    """How far the camera went along `direction` (3,), in the previous camera, linear in both poses and in the scale.

    The same displacement of both poses, however large, changes nothing, so that it holds where it was linearised and
    elsewhere.
    """
    J_previous, J_index = np.zeros((1, 6)), np.zeros((1, 6))
    J_previous[0, 3:], J_index[0, 3:] = -direction, prev_T_cur.rotation().unrotate(direction)
    values = gtsam.Values()
    values.insert(pose_key(previous), world_T_previous)
    values.insert(pose_key(index), world_T_previous.compose(prev_T_cur))
    values.insert(length.scale, length.expected)
    jacobian = gtsam.JacobianFactor(
        pose_key(previous),
        J_previous,
        pose_key(index),
        J_index,
        length.scale,
        np.array([[-length.metres]]),
        np.zeros(1),
        _sigma(length.sigma**2),
    )
    return gtsam.LinearContainerFactor(jacobian, values)


def _sigma(variance: float) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Isotropic.Sigma(1, math.sqrt(variance))
