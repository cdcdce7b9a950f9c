"""Series of readings of other sensors than the camera."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

GRAVITY_SIGMA = 0.02  # rad, of the direction that an inertial unit's filter tells while the vehicle accelerates
MAX_READING_GAP = 0.5  # seconds between two readings between which nothing is interpolated


class SensorKind(StrEnum):
    """The quantity that a series measures, with its columns and units."""

    GNSS = "gnss"  # latitude, longitude (degrees), altitude (m), all WGS84; sigmas in metres north, east, up
    RANGE = "range"  # distance along the beam, m
    HEIGHT = "height"  # above the place of take-off, m
    PRESSURE = "pressure"  # of the air, Pa
    ATTITUDE = "attitude"  # of the camera: yaw from north to east, pitch above the horizon, roll to the right, rad


@dataclass(frozen=True)
class Fix:
    """One position by a GNSS receiver.

    Attributes:
        stamp: Seconds on the clock of the images.
        place: (3,) latitude, longitude (degrees) and altitude (m), WGS84.
        sigmas: (3,) standard deviations east, north, up, metres.
    """

    stamp: float
    place: NDArray[np.float64]
    sigmas: NDArray[np.float64]


@dataclass(frozen=True)
class SensorSeries:
    """Readings of one sensor over time.

    Attributes:
        kind: What is measured; `SensorKind` has the columns and units of each.
        stamps: (N,) seconds on the clock of the images, strictly increasing.
        values: (N, D) finite readings.
        sigmas: (N, D) standard deviations; NaN where unknown.
        source: Where the readings come from: a topic, a file.
    """

    kind: SensorKind
    stamps: NDArray[np.float64]
    values: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    source: str

    def __len__(self) -> int:
        return len(self.stamps)

    def interpolate(self, stamps: NDArray[np.float64], max_gap: float = MAX_READING_GAP) -> NDArray[np.float64]:
        """Readings (M, D) at other times (M,), as `interpolate` has them."""
        columns = [interpolate(self.stamps, column, stamps, max_gap) for column in self.values.T]
        return np.column_stack(columns)


def interpolate(
    stamps: NDArray[np.float64], values: NDArray[np.float64], at: NDArray[np.float64], max_gap: float
) -> NDArray[np.float64]:
    """Values (N,) at other times (M,), on the straight line between neighbours; NaN outside and in gaps.

    A gap is longer than `max_gap` seconds; stamps are strictly increasing.
    """
    after = np.clip(np.searchsorted(stamps, at), 0, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    known = (at >= stamps[0]) & (at <= stamps[-1])
    known &= (stamps[after] - stamps[before] <= max_gap) | (stamps[after] == at)
    return np.where(known, np.interp(at, stamps, values), np.nan)
