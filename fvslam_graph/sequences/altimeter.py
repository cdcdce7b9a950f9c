"""Heights above the ground by an altimeter that ran beside the camera, at a rate of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sensors import MAX_READING_GAP, SensorKind, SensorSeries
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.sequences.ground import UAV_TILT, level_ground
from fvslam_graph.sequences.tables import read_table, require_increasing, to_numbers

HEADERS = (["stamp", "height"], ["stamp", "height", "sigma"])
NEIGHBOURS = 9  # readings around one that tell whether it is an outlier
OFF_SIGMAS = 4.0  # deviations from their median
MIN_HEIGHT_SIGMA = 0.01  # metres; a height is known no better, since ground is not a plane
NORMAL_MAD = 1.4826  # standard deviation of a normal distribution, in median absolute deviations
LONG_GAP = 3.5  # usual intervals without a reading, after which heights are unknown


def read_altimeter(path: Path) -> SensorSeries:
    """Read `stamp,height[,sigma]`: seconds on the clock of the images, metres above the ground.

    Single outliers are left out. Where the file has no deviations, readings tell them by how they differ from their
    neighbours.

    Raises:
        SequenceError: The file cannot be read, has other columns, or tells no heights.
    """
    header, *rows = read_table(path, ",") or [[]]
    if header not in HEADERS or not rows:
        raise SequenceError(f"{path} should have a first line stamp,height or stamp,height,sigma, and rows of numbers")
    numbers = to_numbers(path, [[word or "nan" for word in row] for row in rows])
    if numbers.shape[1] != len(header):
        raise SequenceError(f"{path}: rows have {numbers.shape[1]} values, the first line names {len(header)}")
    numbers = numbers[np.isfinite(numbers).all(axis=1)]
    if len(numbers) < 2:
        raise SequenceError(f"{path} has {len(numbers)} complete readings, at least 2 are needed")
    require_increasing(path, numbers[:, 0])
    heights = numbers[:, 1]
    away, spread = _against_neighbours(heights)
    usual = max(NORMAL_MAD * float(np.median(np.abs(away))), MIN_HEIGHT_SIGMA)
    sigmas = np.maximum(numbers[:, 2], MIN_HEIGHT_SIGMA) if len(header) == 3 else np.full(len(heights), usual)
    good = (np.abs(away) <= OFF_SIGMAS * np.maximum(spread, sigmas)) & (heights > 0)
    if 2 * good.sum() < len(good):
        raise SequenceError(f"{path}: most heights are not above zero, or far from their neighbours")
    return SensorSeries(
        SensorKind.HEIGHT, numbers[good, 0], heights[good, None], sigmas[good, None], f"altimeter {path.name}"
    )


def _against_neighbours(heights: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far readings (N,) are from the median of those around them, and how far these are, as a deviation, (N,).

    It is Hampel's filter: where the vehicle climbs, neighbours differ, and so may the reading.
    """
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(heights, NEIGHBOURS // 2, mode="reflect"), NEIGHBOURS)
    medians = np.median(windows, axis=1)
    return heights - medians, NORMAL_MAD * np.median(np.abs(windows - medians[:, None]), axis=1)


def with_altimeter(sequence: Sequence, readings: SensorSeries) -> Sequence:
    """The sequence with heights above the ground by an altimeter, NaN where it has none.

    Raises:
        SequenceError: The altimeter has no reading during the recording.
    """
    gap = max(MAX_READING_GAP, LONG_GAP * float(np.median(np.diff(readings.stamps))))
    heights: NDArray[np.float64] = readings.interpolate(sequence.stamps, gap)[:, 0]
    if not np.isfinite(heights).any():
        raise SequenceError(
            f"{readings.source}: no height while images were taken, {sequence.stamps[0]:.3f} to "
            f"{sequence.stamps[-1]:.3f} s; are its stamps of the same clock?"
        )
    known = sequence.ground or level_ground(heights, UAV_TILT, readings.source)
    sigma = float(np.sqrt((readings.sigmas**2).mean()))
    ground = replace(known, heights=heights, height_sigma=sigma, common_sigma=0.0, source=readings.source)
    return replace(sequence, ground=ground)
