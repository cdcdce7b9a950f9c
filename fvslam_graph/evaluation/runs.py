"""Evaluation of run folders and of trajectory files, as the command line asks for it."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from fvslam_graph.errors import ResultsError, TrajectoryError
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.association import load_pair
from fvslam_graph.evaluation.metrics import Evaluation, evaluate
from fvslam_graph.results import Run
from fvslam_graph.run_folder import read_run
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
    truth = None if reference is None else load_pair(folder, reference)[1]
    evaluation = evaluation_of(read_run(folder), truth, align)
    evaluation.write(folder)
    return evaluation


def evaluate_files(estimate: Path, reference: Path, align: Alignment = Alignment.SE3) -> Evaluation:
    """Evaluate any TUM or KITTI file against another one.

    Raises:
        TrajectoryError: A trajectory cannot be read, or the two have no time in common.
    """
    return evaluate(*load_pair(estimate, reference), align, name=estimate.stem)


def evaluation_of(run: Run, truth: Trajectory | None = None, align: Alignment = Alignment.SE3) -> Evaluation:
    """Evaluate the online trajectory of a run without writing anything; NEES is over the tracked frames.

    Of a smoothed trajectory, the positions alone.

    Args:
        run: Read from its folder or in memory.
        truth: In place of the ground truth that came with the recording.
        align: How the estimate is brought into the world of the reference.

    Raises:
        ResultsError: There is no ground truth.
        TrajectoryError: The trajectories have no time in common.
    """
    truth = run.ground_truth if truth is None else truth
    if truth is None:
        raise ResultsError(
            f"{run.folder or run.name} has no ground truth; give a reference trajectory (TUM or KITTI file)"
        )
    relatives = run.relatives
    if relatives is not None:
        tracked = (run.frames["status"] == Status.TRACKED)[:, None, None]
        relatives = replace(relatives, covariances=np.where(tracked, relatives.covariances, np.nan))
    evaluation = evaluate(run.online, truth, align, run.name, run.info.get("frames"), relatives)
    if run.smoothed is None:
        return evaluation
    try:
        errors = evaluate(run.smoothed, truth, align).errors
    except TrajectoryError:  # too few of its poses are determined
        return evaluation
    return replace(evaluation, smoothed=float(errors["ape_trans"].stats["rmse"]))
