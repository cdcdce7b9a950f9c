"""Which pose of the reference belongs to which pose of the estimate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.errors import TrajectoryError
from fvslam_graph.run_folder import read_run
from fvslam_graph.trajectory import Trajectory

MAX_DIFFERENCE = 0.01  # s between associated stamps: the default of evo_ape
SAME_INSTANT = 1e-3  # s; two poses closer in time count as simultaneous: 1 cm at 10 m/s


@dataclass(frozen=True)
class Association:
    """The poses of an estimate that have a reference, and their references.

    Attributes:
        indices: (M,) which poses of the whole estimate these are.
        estimate: M poses.
        reference: M poses, pose by pose those of `estimate`, in a world of their own.
        interpolated: The reference was interpolated at the estimate's stamps.
    """

    indices: NDArray[np.int64]
    estimate: Trajectory
    reference: Trajectory
    interpolated: bool


def associate(estimate: Trajectory, reference: Trajectory) -> Association:
    """Pair the poses by their stamps.

    Where the nearest stamps agree within SAME_INSTANT, these are the pairs of `evo_ape`. Where they do not, as with
    ground truth at another rate than the images, the nearest pose would cost speed times offset (5 cm at 10 m/s and
    5 ms), and the reference is interpolated at the stamps of the estimate instead.

    Raises:
        TrajectoryError: Fewer than two poses have a reference.
    """
    from evo.core.sync import matching_time_indices

    if not len(estimate) or not len(reference):
        raise TrajectoryError("a trajectory without poses cannot be evaluated")
    a, b = estimate.stamps, reference.stamps
    if len(b) > len(a):  # from the shorter one, as evo does, so that none of its poses is lost
        rows, partners = np.array(matching_time_indices(a, b, MAX_DIFFERENCE), dtype=int)
    else:
        partners, rows = np.array(matching_time_indices(b, a, MAX_DIFFERENCE), dtype=int)
    interpolated = len(rows) == 0 or bool(np.max(np.abs(a[rows] - b[partners])) > SAME_INSTANT)
    if interpolated:
        matched = reference.interpolate(a)
        rows = np.flatnonzero(np.isin(a, matched.stamps))
    else:
        matched = _rows(reference, partners)
    if len(rows) < 2:
        raise TrajectoryError(
            f"{len(rows)} of {len(a)} poses have a reference: the estimate lasts from {a[0]:.3f} to {a[-1]:.3f} s, "
            f"the reference from {b[0]:.3f} to {b[-1]:.3f} s; two are needed"
        )
    return Association(rows, _rows(estimate, rows), matched, interpolated)


def load_trajectory(path: Path) -> Trajectory:
    """Read a TUM file, a KITTI file (stamps 0, 1, 2, ...) or the online trajectory of a run folder.

    Raises:
        TrajectoryError: It is none of these, or damaged.
        ResultsError: It is a folder, but not that of a run.
    """
    if path.is_dir():
        return read_run(path).online
    return Trajectory.read_kitti(path) if has_no_stamps(path) else Trajectory.read_tum(path)


def load_pair(estimate: Path, reference: Path) -> tuple[Trajectory, Trajectory]:
    """Read two trajectories for comparison; a KITTI file, which has no stamps, belongs row by row to the other.

    Raises:
        TrajectoryError: One cannot be read, or a KITTI file has another number of poses than the other trajectory.
        ResultsError: One is a folder, but not that of a run.
    """
    a, b = load_trajectory(estimate), load_trajectory(reference)
    for path in (estimate, reference):
        if len(a) != len(b) and path.is_file() and has_no_stamps(path):
            raise TrajectoryError(
                f"{path} has no stamps, so {estimate} and {reference} must have equally many poses, "
                f"not {len(a)} and {len(b)}; use TUM files, which have stamps"
            )
    if estimate.is_file() and has_no_stamps(estimate):
        return Trajectory(b.stamps, a.poses), b
    if reference.is_file() and has_no_stamps(reference):
        return a, Trajectory(a.stamps, b.poses)
    return a, b


def has_no_stamps(path: Path) -> bool:
    """Whether a file is in KITTI's format: twelve numbers in its first line of data; TUM has eight."""
    try:
        with path.open() as file:
            lines = (line for line in file if line.strip() and not line.lstrip().startswith("#"))
            columns = len(next(lines, "").replace(",", " ").split())
    except (OSError, UnicodeDecodeError) as error:
        raise TrajectoryError(f"{path} cannot be read as a trajectory: {error}") from None
    if columns not in (8, 12):
        raise TrajectoryError(
            f"{path} is neither a TUM file (8 numbers a line) nor a KITTI file (12): it has {columns}"
        )
    return columns == 12


def _rows(trajectory: Trajectory, rows: NDArray[np.int64]) -> Trajectory:
    return Trajectory(trajectory.stamps[rows], tuple(trajectory.poses[row] for row in rows))
