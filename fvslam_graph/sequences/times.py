"""`times.csv` of a plain folder or beside a video: when each image was taken, and how high."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sequence import Ground
from fvslam_graph.sequences.ground import UAV_TILT, altimeter_readings, level_ground
from fvslam_graph.sequences.tables import read_table, require_increasing, to_numbers

TIMES = "times.csv"


@dataclass(frozen=True)
class Times:
    """What the file lists, a row an image.

    Attributes:
        names: (N,) of the image files; None where it lists none.
        stamps: (N,) seconds, increasing.
        ground: The ground as its heights know it; None where there are none.
        notes: Oddities, one sentence each.
    """

    names: tuple[str, ...] | None
    stamps: NDArray[np.float64]
    ground: Ground | None
    notes: tuple[str, ...]


def read_times(path: Path, columns: tuple[str, ...] = ("timestamp_s",)) -> Times:
    """Read the file.

    Args:
        path: It has a line of titles: `filename`, `timestamp_s`, and where it is known `height_m`.
        columns: Those that must be there.

    Raises:
        SequenceError: A column is missing, a row is no numbers, stamps do not increase, most heights are below zero.
    """
    header, *rows = read_table(path, ",") or [[]]
    if not set(columns) <= set(header) or not rows:
        raise SequenceError(f"{path} should have a header with {' and '.join(columns)}, and a row for each image")
    for number, row in enumerate(rows, 1):
        if len(row) != len(header):
            raise SequenceError(f"{path}: row {number} has {len(row)} values, the header has {len(header)}")
    listed = dict(zip(header, zip(*rows, strict=True), strict=True))
    stamps = to_numbers(path, [[stamp] for stamp in listed["timestamp_s"]])[:, 0]
    require_increasing(path, stamps)
    heights = to_numbers(path, [[height or "nan"] for height in listed.get("height_m", ())]).ravel()
    above, resolution, notes = altimeter_readings(heights, str(path))
    ground = None
    if np.isfinite(above).any():
        ground = replace(level_ground(above, UAV_TILT, f"{TIMES} height_m"), height_sigma=resolution)
    return Times(listed.get("filename"), stamps, ground, notes)
