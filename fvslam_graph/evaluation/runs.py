"""Evaluation of runs and trajectories, in memory or in files: one function for Python and the command line."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from fvslam_graph.core.errors import ResultsError, TrajectoryError
from fvslam_graph.core.trajectory import Status, Trajectory
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.association import is_folder, load_trajectory
from fvslam_graph.evaluation.metrics import EstimateDetails, Evaluation, evaluate
from fvslam_graph.runs.results import Run
from fvslam_graph.runs.run_folder import read_run


def evaluate_run(folder: Path, reference: Path | None = None, align: Alignment = Alignment.SE3) -> Evaluation:
    """Evaluate the online trajectory of a run and write the outcome into its folder; see `Evaluation.write`.

    Arguments and errors are those of `evaluation_of`.

    Raises:
        ResultsError: The folder is not that of a run, or cannot be written.
    """
    evaluation = evaluation_of(folder, reference, align)
    evaluation.write(folder)
    return evaluation


def evaluation_of(
    estimated: Run | Trajectory | str | Path,
    reference: Trajectory | str | Path | None = None,
    align: Alignment | str = Alignment.SE3,
    time_offset: float = 0.0,
) -> Evaluation:
    """Evaluate a trajectory, or the online one of a run with the NEES of its tracked frames; nothing is written.

    Of a smoothed trajectory, the positions alone.

    Args:
        estimated: A run, a trajectory, a run folder, or a file in TUM's, KITTI's or the ASL layout.
        reference: A trajectory or such a file; without it, the ground truth that came with the recording of a run.
        align: How the estimate is brought into the world of the reference.
        time_offset: Seconds, added to the stamps of the estimate to get those of the reference (evo's --t_offset).

    Raises:
        FvslamError: Something cannot be read, there is no reference, or the two have no time in common.
    """
    align, name = Alignment.named(align), "estimate"
    if isinstance(estimated, str | Path):
        path = Path(estimated)
        estimated, name = read_run(path) if is_folder(path) else load_trajectory(path), path.stem
    if isinstance(reference, str | Path):
        reference = load_trajectory(Path(reference))
    if isinstance(estimated, Trajectory):
        if reference is None:
            raise TrajectoryError(f"{name} needs a reference: give the trajectory to compare it with")
        return evaluate(estimated, reference, align, EstimateDetails(name), time_offset)
    return _of_run(estimated, reference, align, time_offset)


def _of_run(run: Run, reference: Trajectory | None, align: Alignment, time_offset: float) -> Evaluation:
    truth = run.ground_truth if reference is None else reference
    if truth is None:
        raise ResultsError(
            f"{run.folder or run.name} has no ground truth; give a reference trajectory (TUM or KITTI file)"
        )
    if not len(run.online):
        raise ResultsError(f"{run.folder or run.name} holds no poses to evaluate")
    relatives = run.relatives
    if relatives is not None:
        tracked = (run.frames["status"] == Status.TRACKED)[:, None, None]
        relatives = replace(relatives, covariances=np.where(tracked, relatives.covariances, np.nan))
    details = EstimateDetails(run.name, run.info.get("frames"), relatives)
    evaluation = evaluate(run.online, truth, align, details, time_offset)
    if run.smoothed is None:
        return evaluation
    try:
        errors = evaluate(run.smoothed, truth, align, time_offset=time_offset).errors
    except TrajectoryError:  # too few of its poses are determined
        return evaluation
    return replace(evaluation, smoothed=float(errors["ape_trans"].stats["rmse"]))
