"""Errors on the frames that all methods have a pose for, so that leaving out hard ones is no advantage."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.association import TrajectoryPairs, associate
from fvslam_graph.evaluation.pose_errors import PoseErrors, Similarity, aligned
from fvslam_graph.study.jobs import Row

COMMON_COLUMNS = ("common", "ape_common", "rpe_common")


def with_common_frames(
    rows: Sequence[Row],
    trajectories: Iterable[Trajectory],
    frames: NDArray[np.float64],
    truth: Trajectory,
    align: Alignment,
) -> list[Row]:
    """The rows of one sequence with COMMON_COLUMNS: how many frames all have, and APE and RPE (m) on these alone.

    Args:
        rows: Of runs that came to their end and have errors.
        trajectories: Of these runs, in their order.
        frames: (N,) stamps of the sequence.
        truth: Its ground truth.
        align: As for the other errors; it is found anew on these frames.
    """
    pairs = [associate(trajectory, truth) for trajectory in trajectories]
    numbers = [nearest(found.estimate.stamps, frames) for found in pairs]
    common = reduce(np.intersect1d, numbers)
    found = []
    for row, known, number in zip(rows, pairs, numbers, strict=True):
        ape, rpe = _errors(known.part(np.flatnonzero(np.isin(number, common))), align)
        found.append(row | {"common": len(common), "ape_common": ape, "rpe_common": rpe})
    return found


def with_own_frames(row: Row) -> Row:
    """The row where all methods of the sequence have a pose for the same frames."""
    return row | {"common": row["associated"], "ape_common": row["ape"], "rpe_common": row["rpe"]}


def nearest(stamps: NDArray[np.float64], frames: NDArray[np.float64]) -> NDArray[np.int64]:
    """Which frames, (M,), stamps (M,) are nearest to; both are sorted, seconds."""
    after = np.clip(np.searchsorted(frames, stamps), 1, max(len(frames) - 1, 1))
    pairs = np.minimum(np.stack([after - 1, after]), len(frames) - 1)
    away = np.abs(frames[pairs] - stamps)
    found: NDArray[np.int64] = np.where(away[0] <= away[1], pairs[0], pairs[1])
    return found


def _errors(pairs: TrajectoryPairs, align: Alignment) -> tuple[float, float]:
    """RMSE of APE and of RPE from frame to frame, metres; NaN where the frames do not determine the alignment."""
    fit = Similarity.between(pairs) if len(pairs.indices) > 1 else None
    if fit is None:
        return np.nan, np.nan
    errors = PoseErrors(pairs, align, *aligned(pairs, align, fit), "estimate").results()
    return float(errors["ape_trans"].stats["rmse"]), float(errors["rpe_trans"].stats["rmse"])
