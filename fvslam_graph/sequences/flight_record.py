"""Flight records of DJI's drones as CSV, as the usual converters write them: columns and units by the header.

Phantom Help and Flight Reader write `OSD.flyTime [s]`, `OSD.height [ft]`, `GIMBAL.pitch`; Airdata writes
`time(millisecond)`, `height_above_takeoff(feet)`, `gimbal_pitch(degrees)`.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sensors import SensorSeries
from fvslam_graph.core.text_files import read_text
from fvslam_graph.sequences.drone_record import sensor_series

_TITLE = re.compile(r"\s*([^\[(]*?)\s*(?:[\[(]([^\])]*)[\])])?\s*")  # a name, and its unit in brackets
_SECONDS = {"s": 1.0, "millisecond": 1e-3, "ms": 1e-3}
_METRES = {"m": 1.0, "meters": 1.0, "ft": 0.3048, "feet": 0.3048}
_DEGREES = {"": 1.0, "degrees": 1.0, "deg": 1.0}
# Names in lower case, and what a unit is worth.
_COLUMNS = {
    "time": (("osd.flytime", "time"), _SECONDS),
    "height": (("osd.height", "height_above_takeoff"), _METRES),
    "latitude": (("osd.latitude", "latitude"), _DEGREES),
    "longitude": (("osd.longitude", "longitude"), _DEGREES),
    "altitude": (("osd.altitude", "altitude_above_sealevel"), _METRES),
    "yaw": (("gimbal.yaw", "gimbal_heading"), _DEGREES),
    "pitch": (("gimbal.pitch", "gimbal_pitch"), _DEGREES),
    "roll": (("gimbal.roll", "gimbal_roll"), _DEGREES),
}


def read_flight_record(path: Path) -> tuple[SensorSeries, ...]:
    """The series of a flight record; stamps are seconds on its own clock.

    Raises:
        SequenceError: It cannot be read, has another layout or a unit that is not known.
    """
    lines = read_text(path, SequenceError).splitlines()
    first = 1 if lines and lines[0].startswith("sep=") else 0  # for spreadsheets
    try:
        header, *rows = list(csv.reader(lines[first:])) or [[]]
    except csv.Error as error:
        raise SequenceError(f"{path} cannot be read as comma-separated values: {error}") from None
    places = {field: _find(path, header, field) for field in _COLUMNS}
    columns = {field: _numbers(path, rows, *place) for field, place in places.items() if place is not None}
    if "time" not in columns or not columns.keys() & {"height", "latitude", "pitch"}:
        raise SequenceError(
            f"{path} is no flight record of a known layout: its first line should name the columns, such as "
            "'OSD.flyTime [s]' and 'OSD.height [m]', or 'time(millisecond)' and 'height_above_takeoff(meters)'"
        )
    return sensor_series(path, columns.pop("time"), columns)


def _find(path: Path, header: list[str], field: str) -> tuple[int, float] | None:
    """Where a field is, and what its unit is worth; None where it is not there."""
    names, units = _COLUMNS[field]
    unknown = None
    for column, title in enumerate(header):
        match = _TITLE.fullmatch(title)
        if match and match[1].lower() in names:
            if (unit := (match[2] or "").lower()) in units:
                return column, units[unit]
            unknown = title
    if unknown is not None:
        known = ", ".join(f"'{unit}'" for unit in units if unit)
        raise SequenceError(f"{path}: the column '{unknown.strip()}' has none of the units {known}")
    return None


def _numbers(path: Path, rows: list[list[str]], column: int, unit: float) -> NDArray[np.float64]:
    """One column, (N,); NaN where a row is cut off or has nothing there."""
    words = [row[column].strip() if column < len(row) else "" for row in rows]
    try:
        return unit * np.array([word or "nan" for word in words], float)
    except ValueError:
        number = next(number for number, word in enumerate(words, 1) if not _is_number(word))
        raise SequenceError(f"{path}: row {number} has '{words[number - 1][:60]}' where a number is expected") from None


def _is_number(word: str) -> bool:
    try:
        float(word or "nan")
    except ValueError:
        return False
    return True
