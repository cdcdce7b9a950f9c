"""A finished run in Rerun, as it was while it went on."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.errors import FvslamError, ResultsError
from fvslam_graph.core.frame_result import FrameResult
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Status
from fvslam_graph.evaluation.plots.landmarks import recording_of
from fvslam_graph.evaluation.viewer import FEATURE_COLUMNS, SCALE_COLUMNS, Viewer
from fvslam_graph.runs.frame_files import LANDMARKS
from fvslam_graph.runs.landmark_table import read_landmarks_by_frame
from fvslam_graph.runs.results import Run


def show_run(run: Run, folder: Path, target: str) -> tuple[str, ...]:
    """Show a finished run as it was while it went on; of its tracks, nothing is kept.

    Args:
        run: As read from its folder,
        folder: which is this.
        target: As for `Viewer`.

    Returns:
        Notes on what cannot be shown.

    Raises:
        FvslamError: As by `Viewer`, or landmarks.csv is damaged.
    """
    sequence: Sequence | None
    notes: tuple[str, ...]
    try:
        sequence, notes = recording_of(folder, run), ()
    except FvslamError as error:
        sequence, notes = None, (f"without images: {error}",)
    table = folder / LANDMARKS
    try:
        landmarks = read_landmarks_by_frame(table) if table.exists() else {}
    except ValueError as error:
        raise ResultsError(f"{table} cannot be read, the run must be done again: {error}") from None
    with Viewer(target, run.name, sequence.camera if sequence else _camera(run), run.ground_truth) as viewer:
        for index, pose in enumerate(run.online.poses):
            viewer.see(sequence.load(index) if sequence else None)
            viewer.show(_result(run, index, pose), landmarks.get(index))
        viewer.end(run.smoothed)
    return notes


def _camera(run: Run) -> Camera:
    try:
        return Camera(**run.info["camera"])
    except (KeyError, TypeError):
        raise ResultsError(f"{run.name} does not know its camera; run it again") from None


def _result(run: Run, index: int, pose: gtsam.Pose3) -> FrameResult:
    """What a folder holds of the result of a frame."""
    measures = {
        name: float(run.frames[name][index]) for name in (*SCALE_COLUMNS, *FEATURE_COLUMNS) if name in run.frames
    }
    covariance = np.zeros((6, 6)) if run.pose_covariances is None else run.pose_covariances[index]
    estimate, status = GaussianPose(pose, covariance), Status(run.frames["status"][index])
    return FrameResult(
        index, float(run.online.stamps[index]), estimate, status, index, GaussianPose.identity(), measures, {}
    )
