"""A run as it is drawn: aligned, in a frame whose axes are right, forward and up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.choices import RELATIVE_SOURCES
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.metrics import Evaluation
from fvslam_graph.evaluation.plots.style import Look, legible
from fvslam_graph.evaluation.pose_consistency import PoseConsistency, pose_consistency
from fvslam_graph.evaluation.runs import evaluation_of
from fvslam_graph.runs.results import Run


@dataclass(frozen=True)
class Curve:
    """A run as it is drawn.

    Attributes:
        run: What was estimated.
        evaluation: None without ground truth.
        look: Colour and style.
        estimate: The online trajectory, aligned; its axes are right, forward and up.
        reference: (M, 3) where the ground truth is at each of its poses; None without ground truth.
        level: (3, 3) rows right, forward and up in the first camera frame.
    """

    run: Run
    evaluation: Evaluation | None
    look: Look
    estimate: Trajectory
    reference: NDArray[np.float64] | None
    level: NDArray[np.float64]

    @property
    def scale(self) -> float:
        """The factor that the alignment puts on lengths."""
        evaluation = self.evaluation
        return evaluation.scale if evaluation is not None and evaluation.alignment is Alignment.SIM3 else 1.0

    @cached_property
    def consistency(self) -> PoseConsistency | None:
        """Errors of its poses beside their covariances; None without a reference or covariances."""
        if self.evaluation is None:
            return None
        return pose_consistency(self.evaluation.pairs, self.run.pose_covariances, self.scale)

    @property
    def metric(self) -> bool:
        """Whether its lengths are metres."""
        scaled = self.evaluation is not None and self.evaluation.alignment is Alignment.SIM3
        return scaled or self.run.info.get("scale_source") not in RELATIVE_SOURCES

    @property
    def unit(self) -> str:
        """The unit of its lengths: metres, or its own."""
        return "m" if self.metric else "own unit"

    @property
    def name(self) -> str:
        """The name in legends, which says where lengths are no metres."""
        return legible(self.run.name) + ("" if self.metric else ", relative scale")


def common_unit(curves: Sequence[Curve]) -> str:
    """The unit of an axis: metres where there is a reference or the scale is metric."""
    return "m" if any(curve.metric or curve.evaluation for curve in curves) else "own unit"


def curve_of(run: Run, align: Alignment, number: int, level: NDArray[np.float64], origin: NDArray[np.float64]) -> Curve:
    """Align a run with its ground truth, where it has one.

    Args:
        run: Of at least two poses.
        align: How.
        number: Of the run, for its look.
        level: (3, 3) rows right, forward, up in the first camera frame.
        origin: (4, 4) from the world of the ground truth to the first camera frame.
    """
    upright = np.eye(4)
    upright[:3, :3] = level
    if run.ground_truth is None:
        own = run.online.from_origin()
        moved = Trajectory.from_matrices(own.stamps, upright @ own.matrices)
        return Curve(run, None, Look(number), moved, None, level)
    evaluation = evaluation_of(run, None, align)
    aligned = evaluation.errors["ape_trans"].trajectories[evaluation.name]
    estimate = Trajectory.from_matrices(aligned.timestamps, upright @ origin @ np.array(aligned.poses_se3))
    reference = (upright @ origin @ evaluation.pairs.reference.matrices)[:, :3, 3]
    return Curve(run, evaluation, Look(number), estimate, reference, level)
