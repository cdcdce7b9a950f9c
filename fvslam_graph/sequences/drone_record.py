"""What drones record of a flight, made into sensor series: heights, places, the attitude of the gimbal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sensors import SensorKind, SensorSeries

Array = NDArray[np.float64]

HEIGHT = ("height",)  # metres above the place of take-off
GNSS = ("latitude", "longitude", "altitude")  # degrees, degrees, metres
ATTITUDE = ("yaw", "pitch", "roll")  # of the camera, degrees: from north to east, above the horizon, to the right
MAX_RECORD_GAP = 2.5  # seconds over which is interpolated; the oldest records have a row a second

FIELDS = (*HEIGHT, *GNSS, *ATTITUDE)


def sensor_series(path: Path, stamps: Array, columns: Mapping[str, Array]) -> tuple[SensorSeries, ...]:
    """Series on the clock of the record.

    Rows that are not later than those before them are left out: records repeat some.

    Args:
        path: The record.
        stamps: (N,) seconds.
        columns: Those of FIELDS that the record has, (N,) each; NaN where a row has no value. Latitude and longitude
            of zero are no place, but a receiver that has none.

    Raises:
        SequenceError: Nothing is known, or a place is none on Earth.
    """
    latest = np.fmax.accumulate(np.concatenate([[-np.inf], stamps[:-1]]))
    usable = np.isfinite(stamps) & (stamps > latest)
    table = {field: np.asarray(columns.get(field, np.full(len(stamps), np.nan)), float)[usable] for field in FIELDS}
    no_fix = (table["latitude"] == 0) & (table["longitude"] == 0)
    for field, most in (("latitude", 90), ("longitude", 180)):
        table[field] = np.where(no_fix, np.nan, table[field])
        if (wrong := table[field][np.abs(table[field]) > most]).size:
            raise SequenceError(f"{path}: {wrong[0]:g} is no {field} in degrees")

    kept = [
        _series(SensorKind.HEIGHT, stamps[usable], [table[field] for field in HEIGHT], path),
        _series(SensorKind.GNSS, stamps[usable], [table[field] for field in GNSS], path),
        _series(SensorKind.ATTITUDE, stamps[usable], [np.radians(table[field]) for field in ATTITUDE], path),
    ]
    found = tuple(series for series in kept if len(series) > 1)
    if not found:
        raise SequenceError(f"{path} has no heights, places or attitudes of a drone")
    return found


def _series(kind: SensorKind, stamps: Array, columns: list[Array], path: Path) -> SensorSeries:
    """The rows in which all of the columns are known."""
    values = np.column_stack(columns)
    known = np.isfinite(values).all(axis=1)
    sigma = _resolution(values[known, 0]) if kind is SensorKind.HEIGHT else np.nan
    return SensorSeries(kind, stamps[known], values[known], np.full(values[known].shape, sigma), path.name)


def _resolution(readings: Array) -> float:
    """The smallest difference of readings (N,); NaN where all are alike."""
    steps = np.diff(np.unique(readings))
    return round(float(steps.min()), 6) if len(steps) else np.nan
