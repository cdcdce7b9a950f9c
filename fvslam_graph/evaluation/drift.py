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


def drift(estimate: NDArray[np.float64], reference: NDArray[np.float64], scale: float = 1.0) -> Drift:
    """Drift of associated poses, both (N, 4, 4) and metric, each in a world of its own; `scale` is on the estimate.

    From every STEP-th pose, a segment of each length ends at the first pose at which the reference's path is longer.
    """
    steps = np.linalg.norm(np.diff(reference[:, :3, 3], axis=0), axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    starts, lengths = np.meshgrid(np.arange(0, len(travelled), SEGMENT_STEP), LENGTHS, indexing="ij")
    ends = np.searchsorted(travelled, travelled[starts] + lengths, side="right")
    inside = ends < len(travelled)
    starts, lengths, ends = starts[inside], lengths[inside], ends[inside]
    if not len(ends):
        return Drift(float("nan"), float("nan"), 0, {})
    metres, angles = motion_errors(estimate, reference, starts, ends, scale)
    t_rel, r_rel = 100 * metres / lengths, 100 * angles / lengths
    by_length = {
        int(length): (float(t_rel[lengths == length].mean()), float(r_rel[lengths == length].mean()))
        for length in np.unique(lengths)
    }
    return Drift(float(t_rel.mean()), float(r_rel.mean()), len(ends), by_length)
