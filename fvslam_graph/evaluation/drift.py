"""Drift over stretches of 100 to 800 m, as the KITTI odometry benchmark defines it.

Geiger, Lenz, Urtasun, "Are we ready for autonomous driving? The KITTI vision benchmark suite", CVPR 2012.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.evaluation.pose_errors import motion_errors

LENGTHS = np.arange(100.0, 900.0, 100.0)  # m
SEGMENT_STEP = 10  # poses between the starts of segments, as in the benchmark (one second at its 10 Hz)


@dataclass(frozen=True)
class Drift:
    """Mean errors of the end of a segment as seen from its start, per length of the segment.

    Attributes:
        t_rel: Translation, percent; NaN where the path is shorter than the shortest segment.
        r_rel: Rotation, degrees per 100 m.
        segments: How many segments the means are over.
        by_length: (t_rel, r_rel) for each length in metres that occurs.
    """

    t_rel: float
    r_rel: float
    segments: int
    by_length: dict[int, tuple[float, float]]


@dataclass(frozen=True)
class SegmentErrors:
    """Errors of the end of each segment as seen from its start, (S,) each.

    Attributes:
        lengths: Of the segments, metres.
        t_rel: Translation, percent of the length.
        r_rel: Rotation, degrees per 100 m.
    """

    lengths: NDArray[np.float64]
    t_rel: NDArray[np.float64]
    r_rel: NDArray[np.float64]


def segment_errors(
    estimate: NDArray[np.float64],
    reference: NDArray[np.float64],
    lengths: NDArray[np.float64] = LENGTHS,
    scale: float = 1.0,
) -> SegmentErrors:
    """Errors of all segments of associated poses, both (N, 4, 4) and metric, each in a world of its own.

    From every SEGMENT_STEP-th pose, a segment of each of the `lengths` (L,), metres, ends at the first pose at which
    the reference's path is longer. `scale` is on the estimate.
    """
    steps = np.linalg.norm(np.diff(reference[:, :3, 3], axis=0), axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    starts, wanted = np.meshgrid(np.arange(0, len(travelled), SEGMENT_STEP), lengths, indexing="ij")
    ends = np.searchsorted(travelled, travelled[starts] + wanted, side="right")
    inside = ends < len(travelled)
    starts, wanted, ends = starts[inside], wanted[inside], ends[inside]
    metres, angles = motion_errors(estimate, reference, starts, ends, scale)
    return SegmentErrors(wanted, 100 * metres / wanted, 100 * angles / wanted)


def drift(estimate: NDArray[np.float64], reference: NDArray[np.float64], scale: float = 1.0) -> Drift:
    """Mean errors over KITTI's segments; see `segment_errors`."""
    found = segment_errors(estimate, reference, scale=scale)
    count = len(found.lengths)
    if not count:
        return Drift(float("nan"), float("nan"), 0, {})
    by_length = {
        int(length): (
            float(found.t_rel[found.lengths == length].mean()),
            float(found.r_rel[found.lengths == length].mean()),
        )
        for length in np.unique(found.lengths)
    }
    return Drift(float(found.t_rel.mean()), float(found.r_rel.mean()), count, by_length)
