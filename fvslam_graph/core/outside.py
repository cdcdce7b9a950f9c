"""Estimators and fusion rules that are not ours: what they have to be, and that what they say can be used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from fvslam_graph.core.camera import Image
from fvslam_graph.core.errors import EstimationError
from fvslam_graph.core.frame_result import Ending, FrameResult
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.sequence import Frame, Sequence
from fvslam_graph.core.stopwatch import Stopwatch
from fvslam_graph.core.trajectory import Status, Trajectory

READ, STEP = "read", "step"  # the stages of an estimator that does not tell its times
SAME_STAMP = 1e-6  # seconds

Method = Callable[[Sequence, int], "Trajectory | Iterable[FrameResult]"]
"""A whole estimator as a function: of a sequence and a seed, the poses or results of its frames."""


class OutsideEstimator(Protocol):
    """An estimator of another package; its class is made with (camera, ground, seed)."""

    def step(self, image: Image | None, stamp: float, height: float | None) -> FrameResult:
        """Estimate the pose of the next image, (H, W) uint8 or None, at `stamp` seconds and `height` metres."""

    def finish(self) -> Ending | None:
        """What all frames together say; None where nothing is smoothed."""


class OutsideSteps:
    """An estimator of another package, stepped like ours; its results are checked.

    Args:
        name: For errors.
        estimator: It.
    """

    def __init__(self, name: str, estimator: OutsideEstimator) -> None:
        self._estimator = estimator
        self._checks = _Checks(name)

    def step(self, frame: Frame) -> FrameResult:
        """Estimate the pose of the next frame; frames come in the order of their stamps, numbered from 0.

        Raises:
            EstimationError: The result is not that of this frame, or not finite.
        """
        stopwatch = Stopwatch()
        with stopwatch.stage(STEP):
            result = self._estimator.step(frame.image, frame.stamp, frame.height if frame.height > 0 else None)
        return self._checks.checked(result, frame.index, frame.stamp, stopwatch.times)

    def finish(self) -> Ending | None:
        """What all frames together say."""
        return self._estimator.finish()


def method_results(name: str, method: Method, sequence: Sequence, seed: int) -> Iterator[FrameResult]:
    """The results of a function of a whole sequence, as soon as they are known.

    Args:
        name: For errors.
        method: It; where it returns a trajectory, its poses are those of the frames with the same stamps.
        sequence: What it is given.
        seed: Likewise.

    Raises:
        EstimationError: What comes out is not of these frames, or not finite.
    """
    checks, stopwatch = _Checks(name), Stopwatch()

    def load(index: int) -> Image | None:
        with stopwatch.stage(READ):
            return sequence.load(index)

    with stopwatch.stage(STEP):
        said = method(replace(sequence, load=load), seed)
    if isinstance(said, Trajectory):  # only the time of the whole is known: each frame took the mean
        times = {stage: value / max(len(said), 1) for stage, value in stopwatch.times.items()}
        for result in _of_trajectory(name, said, sequence):
            yield checks.checked(result, result.index, result.stamp, times)
        return
    if not isinstance(said, Iterable):
        raise EstimationError(f"{name} returns {_kind(said)}, not a Trajectory or FrameResults")
    results, index = iter(said), 0
    while True:
        with stopwatch.stage(STEP):
            next_result = next(results, None)
        if next_result is None:
            break
        if index == len(sequence):
            raise EstimationError(f"{name} has more results than {sequence.name} has frames, {len(sequence)}")
        yield checks.checked(next_result, index, float(sequence.stamps[index]), {READ: 0.0} | stopwatch.times)
        stopwatch.times.clear()
        index += 1
    if not index:
        raise EstimationError(f"{name} has no result for any frame of {sequence.name}")


def require_pose(name: str, pose: Any, where: str) -> None:
    """Refuse what is no pose with a covariance; one that is not known is NaN.

    Raises:
        EstimationError: Says what is wrong with it.
    """
    if not isinstance(pose, GaussianPose):
        raise EstimationError(f"{name} returns {_kind(pose)} {where}, not a GaussianPose")
    if not np.isfinite(pose.mean.matrix()).all():
        raise EstimationError(f"{name} returns a pose {where} that is not finite")
    covariance = np.asarray(pose.covariance)
    if covariance.shape != (6, 6):
        raise EstimationError(f"{name} returns a covariance {where} of shape {covariance.shape}, not (6, 6)")


class _Checks:
    """Whether results are of the frames that they are taken for, one after the other."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._columns: tuple[set[str], set[str]] | None = None

    def checked(self, result: object, index: int, stamp: float, times: dict[str, float]) -> FrameResult:
        """The result, with these times where it has none of its own."""
        name, where = self._name, f"at frame {index}"
        if not isinstance(result, FrameResult):
            raise EstimationError(f"{name} returns {_kind(result)} {where}, not a FrameResult")
        if result.index != index or abs(result.stamp - stamp) > SAME_STAMP:
            raise EstimationError(
                f"{name} returns the result of frame {result.index} at {result.stamp:.6f} s {where}, {stamp:.6f} s; "
                "there must be one a frame, in order"
            )
        if not 0 <= result.previous <= index:
            raise EstimationError(f"{name} returns a motion from frame {result.previous} {where}")
        if result.status not in list(Status):
            raise EstimationError(
                f"{name} returns the status '{result.status}' {where}, not one of {', '.join(Status)}"
            )
        require_pose(name, result.pose, where)
        require_pose(name, result.relative, where)
        columns = set(result.measures), set(result.times)
        self._columns = self._columns or columns
        if columns != self._columns:
            raise EstimationError(f"{name} returns other measures or times {where} than at the first frame")
        return replace(result, status=Status(result.status), times=dict(result.times) or times)


def _of_trajectory(name: str, trajectory: Trajectory, sequence: Sequence) -> Iterator[FrameResult]:
    """A result for each pose."""
    if not len(trajectory):
        raise EstimationError(f"{name} has no pose for any frame of {sequence.name}")
    frames = np.abs(sequence.stamps[:, None] - trajectory.stamps).argmin(axis=0)
    before = trajectory.poses[0]
    for row, (frame, stamp, pose) in enumerate(
        zip(frames.tolist(), trajectory.stamps.tolist(), trajectory.poses, strict=True)
    ):
        if abs(sequence.stamps[frame] - stamp) > SAME_STAMP:
            raise EstimationError(f"{name} has a pose at {stamp:.6f} s, where {sequence.name} has no frame")
        motion = GaussianPose.without_covariance(before.between(pose))
        # Motions start from results, which are fewer than frames where some have no pose.
        last = max(row - 1, 0)
        yield FrameResult(frame, stamp, GaussianPose.without_covariance(pose), Status.TRACKED, last, motion)
        before = pose


def _kind(what: Any) -> str:
    return f"an object of {type(what).__name__}"
