"""The description of a recording, in words: the content of `fvslam info`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.sequence import Ground, Sequence
from fvslam_graph.core.trajectory import Trajectory

GAP = 1.5  # medians between two stamps that make a gap
MAX_GAPS_LISTED = 5  # gaps that are listed one by one


def describe(sequence: Sequence) -> list[tuple[str, str]]:
    """Facts about a recording as pairs of label and text, without reading its images."""
    camera = sequence.camera
    return [
        ("name", sequence.name),
        ("format", sequence.format),
        ("frames", _time(sequence.stamps)),
        ("images", f"{camera.width}x{camera.height} pixels, gray, rectified"),
        ("camera", f"fx {camera.fx:.2f}, fy {camera.fy:.2f}, cx {camera.cx:.2f}, cy {camera.cy:.2f} pixels"),
        ("ground truth", _ground_truth(sequence.ground_truth, sequence.stamps)),
        ("scale", _ground(sequence.ground)),
        *(("sensor", f"{series.kind} of {series.source}: {_time(series.stamps)}") for series in sequence.sensors),
        ("gaps", _gaps(sequence.stamps)),
        *(("note", note) for note in sequence.notes),
    ]


def _time(stamps: NDArray[np.float64]) -> str:
    if len(stamps) < 2:
        return str(len(stamps))
    rate = 1 / np.median(np.diff(stamps))
    return f"{len(stamps)} in {stamps[-1] - stamps[0]:.1f} s, {rate:.1f} Hz"


def _ground_truth(truth: Trajectory | None, stamps: NDArray[np.float64]) -> str:
    if truth is None or not len(truth):
        return "none"
    covered = np.mean((stamps >= truth.stamps[0]) & (stamps <= truth.stamps[-1]))
    return f"{len(truth)} poses, {truth.path_length:.1f} m, covers {covered:.0%} of the frames"


def _ground(ground: Ground | None) -> str:
    if ground is None:
        return "unknown: no height above ground"
    heights = ground.heights[np.isfinite(ground.heights)]
    if not len(heights):
        return f"no height above ground in these frames ({ground.source})"
    low, high = heights.min(), heights.max()
    height = f"{low:.2f} m" if low == high else f"{low:.2f} to {high:.2f} m"
    if ground.height_sigma:
        height += f" +- {ground.height_sigma:.2f} m"
    if ground.common_sigma:
        height += f" +- {ground.common_sigma:.0%}"
    known = "" if len(heights) == len(ground.heights) else f", known for {len(heights)} frames"
    normal = ", ".join(f"{value:.3f}" for value in ground.normal)
    tilt = np.degrees(ground.normal_sigma)
    return f"camera {height} above ground{known} ({ground.source}); ground normal ({normal}), sigma {tilt:.1f} deg"


def _gaps(stamps: NDArray[np.float64]) -> str:
    steps = np.diff(stamps)
    gaps = np.flatnonzero(steps > GAP * np.median(steps)) if len(steps) else np.empty(0, int)
    if not len(gaps):
        return "none"
    listed = ", ".join(f"{steps[gap]:.2f} s after frame {gap}" for gap in gaps[:MAX_GAPS_LISTED])
    return f"{len(gaps)}: {listed}" + (
        f" and {len(gaps) - MAX_GAPS_LISTED} more" if len(gaps) > MAX_GAPS_LISTED else ""
    )
