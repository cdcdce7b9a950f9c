"""Trajectories of other people's systems, as rows beside our own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import FvslamError, TrajectoryError
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.association import associate, load_trajectory
from fvslam_graph.evaluation.runs import evaluation_of
from fvslam_graph.runs.results import Run
from fvslam_graph.study.common_frames import nearest
from fvslam_graph.study.jobs import Row, metric_columns
from fvslam_graph.study.results import EXTERNAL


def external_run(name: str, file: str, sequence: Sequence) -> Run:
    """A trajectory file as a run on a sequence: of each frame, the pose that is nearest in time.

    Args:
        name: Of the system.
        file: TUM, with the stamps of the recording, or KITTI, one row a frame. `FILE@0.1`: its stamps are the numbers
            of the frames times 0.1 s, as of systems that were fed at a fixed rate.
        sequence: With ground truth.

    Raises:
        TrajectoryError: It cannot be read, or does not belong to the sequence.
    """
    path, period = _split(file)
    trajectory = load_trajectory(path)
    if period is not None:
        trajectory = _at_frames(np.rint(trajectory.stamps / period).astype(int), trajectory, sequence, path)
    elif trajectory.rows is not None:
        if trajectory.rows != len(sequence):
            raise TrajectoryError(
                f"{path} has no stamps, so it must have a pose for each of the {len(sequence)} frames of "
                f"{sequence.name}, not {trajectory.rows}; use a TUM file, which has stamps"
            )
        trajectory = _at_frames(trajectory.stamps.astype(int), trajectory, sequence, path)
    else:
        trajectory = _cut(trajectory, sequence, path)
    return Run(
        name=name,
        online=trajectory,
        smoothed=None,
        ground_truth=sequence.ground_truth,
        frames={},
        config={},
        info={
            **{"status": "finished", "sequence": sequence.name, "mode": name, "frames": len(sequence)},
            "scale_source": EXTERNAL,
        },
        relatives=None,
    )


def external_row(name: str, file: str, sequence: Sequence, align: Alignment) -> tuple[Row, Run | None]:
    """The row of a trajectory file, with the reason where it cannot be compared, and the trajectory."""
    labels = external_labels(name, sequence.name)
    try:
        run = external_run(name, file, sequence)
        found = {} if sequence.ground_truth is None else metric_columns(evaluation_of(run, None, align))
    except FvslamError as error:
        return labels | {"status": f"failed: {error}"}, None
    row = labels | {"status": "finished", "frames": len(sequence), "coverage": run.coverage} | found
    return row, run


def external_labels(name: str, sequence: str) -> Row:
    """The columns that say which row that of a system on a sequence is."""
    return {"sequence": sequence, "mode": name, "preset": EXTERNAL, "variant": ""}


def _cut(trajectory: Trajectory, sequence: Sequence, path: Path) -> Trajectory:
    """The pose nearest to each frame, at most half a frame away, and each pose once."""
    if len(sequence) < 2:
        raise TrajectoryError(f"{sequence.name} has {len(sequence)} frames; to be compared with {path}, it needs two")
    rows = nearest(sequence.stamps, trajectory.stamps)
    period = np.median(np.diff(sequence.stamps))
    kept = np.unique(rows[np.abs(trajectory.stamps[rows] - sequence.stamps) <= period / 2])
    if len(kept) < 2:
        associate(
            trajectory, sequence.ground_truth or trajectory
        )  # other units, or another clock: says how they differ
        raise TrajectoryError(f"{len(kept)} of {len(trajectory)} poses of {path} belong to a frame of {sequence.name}")
    return replace(trajectory, stamps=trajectory.stamps[kept], poses=tuple(trajectory.poses[row] for row in kept))


def _at_frames(frames: NDArray[np.int64], trajectory: Trajectory, sequence: Sequence, path: Path) -> Trajectory:
    """The trajectory with the stamps of these frames of the sequence."""
    if frames.min() < 0 or frames.max() >= len(sequence) or len(np.unique(frames)) < len(frames):
        raise TrajectoryError(
            f"{path} does not belong to the {len(sequence)} frames of {sequence.name}: its poses are for frames "
            f"{frames.min()} to {frames.max()}; use the stamps of the recording, and all its frames"
        )
    return replace(trajectory, stamps=sequence.stamps[frames], rows=None)


def _split(file: str) -> tuple[Path, float | None]:
    path, _, period = file.rpartition("@")
    try:
        return Path(path).expanduser(), float(period)
    except ValueError:
        return Path(file).expanduser(), None
