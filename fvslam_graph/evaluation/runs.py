"""Evaluation of run folders and of trajectory files, as the command line asks for it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fvslam_graph.errors import ResultsError
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.association import load_pair
from fvslam_graph.evaluation.metrics import Evaluation, evaluate
from fvslam_graph.results import FrameResult, Relatives, Run, read_run
from fvslam_graph.trajectory import Status, Trajectory


def evaluate_run(folder: Path, reference: Path | None = None, align: Alignment = Alignment.SE3) -> Evaluation:
    """Evaluate the online trajectory of a run and write the outcome into its folder; see `Evaluation.write`.

    Args:
        folder: Of the run.
        reference: A trajectory file; without it, the ground truth that came with the recording.
        align: How the estimate is brought into the world of the reference.

    Raises:
        ResultsError: The folder is not that of a run, cannot be written, or there is no reference.
        TrajectoryError: A trajectory cannot be read, or the two have no time in common.
    """
    evaluation = evaluation_of(read_run(folder), reference, align)
    evaluation.write(folder)
    return evaluation


def evaluate_files(estimate: Path, reference: Path, align: Alignment = Alignment.SE3) -> Evaluation:
    """Evaluate any TUM or KITTI file against another one.

    Raises:
        TrajectoryError: A trajectory cannot be read, or the two have no time in common.
    """
    return evaluate(*load_pair(estimate, reference), align, name=estimate.stem)


def evaluation_of_results(
    results: Sequence[FrameResult], truth: Trajectory, align: Alignment = Alignment.SE3, name: str = "estimate"
) -> Evaluation:
    """Evaluate what an estimator has said about each frame of a recording; NEES is over the tracked frames."""
    tracked = np.array([result.status is Status.TRACKED for result in results])[:, None, None]
    relatives = Relatives(
        np.array([result.previous for result in results]),
        np.array([result.relative.mean.matrix() for result in results]),
        np.where(tracked, np.array([result.relative.covariance for result in results]), np.nan),
    )
    stamps = np.array([result.stamp for result in results])
    online = Trajectory(stamps, tuple(result.pose.mean for result in results))
    return evaluate(online, truth, align, name, len(results), relatives)


def evaluation_of(run: Run, reference: Path | None = None, align: Alignment = Alignment.SE3) -> Evaluation:
    """Evaluate the online trajectory of a run without writing anything; NEES is over the tracked frames."""
    truth = run.ground_truth if reference is None else load_pair(run.folder, reference)[1]
    if truth is None:
        raise ResultsError(f"{run.folder} has no ground truth; give a reference trajectory (TUM or KITTI file)")
    relatives = run.relatives
    if relatives is not None:
        tracked = (run.frames["status"] == Status.TRACKED)[:, None, None]
        relatives = replace(relatives, covariances=np.where(tracked, relatives.covariances, np.nan))
    return evaluate(run.online, truth, align, run.name, run.info.get("frames"), relatives)
