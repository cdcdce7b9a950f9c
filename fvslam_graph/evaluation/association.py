"""Which pose of the reference belongs to which pose of the estimate."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import TrajectoryError
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.runs.run_folder import read_run

_log = logging.getLogger(__name__)

MAX_STAMP_DIFFERENCE = 0.01  # s between associated stamps: the default of evo_ape
MAX_GAP = 0.5  # s between poses of a reference that are interpolated
STAMP_UNITS = {3: "milliseconds", 6: "microseconds", 9: "nanoseconds"}
MAX_POSES = 1_000_000  # less than a minute and two gigabytes
SAME_INSTANT = 1e-3  # s; two poses closer in time count as simultaneous: 1 cm at 10 m/s


@dataclass(frozen=True)
class TrajectoryPairs:
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

    def part(self, rows: NDArray[np.int64]) -> TrajectoryPairs:
        """Some of the pairs, by their numbers in increasing order."""
        return TrajectoryPairs(
            self.indices[rows], _rows(self.estimate, rows), _rows(self.reference, rows), self.interpolated
        )


def associate(estimate: Trajectory, reference: Trajectory, time_offset: float = 0.0) -> TrajectoryPairs:
    """Pair the poses by their stamps, or row by row where one has none (KITTI files).

    Where the nearest stamps agree within SAME_INSTANT, these are the pairs of `evo_ape`. Where they do not, as with
    ground truth at another rate than the images, the nearest pose would cost speed times offset (5 cm at 10 m/s and
    5 ms), and the reference is interpolated at the stamps of the estimate instead. A reference whose poses are too far
    apart for that is taken as it is, by the pairs of `evo_ape` again.

    Args:
        estimate: Its clock is that of the result.
        reference: In a world of its own.
        time_offset: Seconds, added to the stamps of the estimate to get those of the reference (evo's --t_offset).

    Raises:
        TrajectoryError: Fewer than two poses have a reference; says what the reason may be.
    """
    if not len(estimate) or not len(reference):
        raise TrajectoryError("a trajectory without poses cannot be evaluated")
    if not math.isfinite(time_offset):
        raise TrajectoryError(f"the time offset must be a number of seconds, not {time_offset}")
    if (poses := min(len(estimate), len(reference))) > MAX_POSES:
        raise TrajectoryError(f"{poses} poses are too many to be compared; take every n-th, {MAX_POSES} at most")
    if estimate.rows is not None or reference.rows is not None:
        return _by_rows(estimate, reference)
    if time_offset:
        reference = replace(reference, stamps=reference.stamps - time_offset)
    return _by_stamps(estimate, reference)


def load_trajectory(path: Path) -> Trajectory:
    """Read a trajectory file, or the online trajectory of a run folder.

    Raises:
        TrajectoryError: It is none of these, or damaged.
        ResultsError: It is a folder, but not that of a run.
    """
    _log.info("reading %s", path)
    return read_run(path).online if is_folder(path) else Trajectory.read(path)


def is_folder(path: Path) -> bool:
    """Whether this is a folder; raises TrajectoryError where the path cannot be one at all."""
    try:
        return path.is_dir()
    except (OSError, ValueError) as error:
        raise TrajectoryError(f"{str(path)!r:.80} cannot be read as a trajectory: {error}") from None


def _by_rows(estimate: Trajectory, reference: Trajectory) -> TrajectoryPairs:
    counts = [len(side) if side.rows is None else side.rows for side in (estimate, reference)]
    if counts[0] != counts[1]:
        raise TrajectoryError(
            "a KITTI file has no stamps, so that estimate and reference must have equally many poses, "
            f"not {counts[0]} and {counts[1]}; use TUM files, which have stamps"
        )
    a, b = (np.arange(len(side)) if side.rows is None else side.stamps for side in (estimate, reference))
    _, rows, partners = np.intersect1d(a, b, return_indices=True)
    if len(rows) < 2:
        raise TrajectoryError(f"{len(rows)} of {len(estimate)} poses have a reference; two are needed")
    matched, truth = _rows(estimate, rows), _rows(reference, partners)
    stamps = (matched if reference.rows is not None else truth).stamps
    return TrajectoryPairs(rows, replace(matched, stamps=stamps), replace(truth, stamps=stamps), interpolated=False)


def _by_stamps(estimate: Trajectory, reference: Trajectory) -> TrajectoryPairs:
    from evo.core.sync import matching_time_indices

    a, b = estimate.stamps, reference.stamps
    if len(b) > len(a):  # from the shorter one, as evo does, so that none of its poses is lost
        rows, partners = np.array(matching_time_indices(a, b, MAX_STAMP_DIFFERENCE), dtype=int)
    else:
        partners, rows = np.array(matching_time_indices(b, a, MAX_STAMP_DIFFERENCE), dtype=int)
    matched, interpolated = _rows(reference, partners), False
    if len(rows) == 0 or np.max(np.abs(a[rows] - b[partners])) > SAME_INSTANT:
        between = reference.interpolate(a, MAX_GAP)
        if interpolated := 2 * len(between) > len(rows):
            rows, matched = np.flatnonzero(np.isin(a, between.stamps)), between
    if len(rows) < 2:
        raise TrajectoryError(
            f"{len(rows)} of {len(a)} poses have a reference: the estimate lasts from {a[0]:.3f} to {a[-1]:.3f} s, "
            f"the reference from {b[0]:.3f} to {b[-1]:.3f} s; two are needed{_reason(a, b)}"
        )
    return TrajectoryPairs(rows, _rows(estimate, rows), matched, interpolated)


def _reason(a: NDArray[np.float64], b: NDArray[np.float64]) -> str:
    """Why stamps of an estimate and a reference, (N,) and (M,) seconds, may not match, as far as they tell."""
    longer = np.ptp(a) / np.ptp(b) if np.ptp(a) > 0 and np.ptp(b) > 0 else 1.0
    power = 3 * round(math.log10(longer) / 3)
    if abs(power) in STAMP_UNITS and _overlap(a / 10.0**power, b):
        which = "estimate" if power > 0 else "reference"
        return f". The stamps of the {which} seem to be {STAMP_UNITS[abs(power)]}: divide them by 1e{abs(power)}"
    if not _overlap(a, b):
        return (
            ". Where the clocks differ, give the offset by --time-offset SECONDS, which is added to the stamps of the "
            f"estimate; {b[0] - a[0]:.3f} if both begin together"
        )
    after = np.clip(np.searchsorted(b, a), 1, max(len(b) - 1, 1))
    nearest = np.abs(a[:, None] - b[np.minimum(np.stack([after - 1, after], axis=1), len(b) - 1)]).min()
    gap = f", its poses are {np.median(np.diff(b)):.3g} s apart" if len(b) > 1 else ""
    return (
        f". The nearest stamps are {nearest:.3g} s apart, which may be {MAX_STAMP_DIFFERENCE:g} s{gap}, and a "
        f"reference is interpolated over {MAX_GAP:g} s at most; a clock offset is given by --time-offset SECONDS"
    )


def _overlap(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    return bool(a[0] <= b[-1] and b[0] <= a[-1])


def _rows(trajectory: Trajectory, rows: NDArray[np.int64]) -> Trajectory:
    if len(rows) == len(trajectory):  # which are all, in order: a million poses are no copy
        return trajectory
    return Trajectory(trajectory.stamps[rows], tuple(trajectory.poses[row] for row in rows))
