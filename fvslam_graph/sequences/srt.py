"""Subtitles that DJI's drones write beside a video, with heights, places and the gimbal's attitude.

There are three dialects: keys in brackets (`[latitude: 59.3] [rel_alt: 1.3 abs_alt: 132.8] [gb_pitch: -90.0]`), lines
(`GPS(149.02,-20.25,16) BAROMETER:1.9`) and words (`GPS (-122.36, 37.81, 15), D 24.2m, H 6.0m`).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sensors import SensorSeries
from fvslam_graph.core.text_files import read_text
from fvslam_graph.sequences.drone_record import FIELDS, sensor_series

_SRT_NUMBER = r"[-+]?\d+(?:\.\d+)?"
_TIMING = re.compile(r"^\s*(\d+):(\d\d):(\d\d)[,.](\d{3})\s*-->.*$", re.MULTILINE)
_PAIR = re.compile(rf"\b([A-Za-z_]+)\s*:\s*({_SRT_NUMBER})")
_GPS = re.compile(rf"\bGPS\s*\(\s*({_SRT_NUMBER})\s*,\s*({_SRT_NUMBER})\s*,\s*({_SRT_NUMBER})\s*(M?)\s*\)")
_H = re.compile(rf"\bH\s+({_SRT_NUMBER})\s*m\b")
_KEYS = {
    "height": ("rel_alt", "barometer"),
    "latitude": ("latitude",),
    "longitude": ("longitude", "longtitude"),  # some write it so
    "altitude": ("abs_alt", "altitude"),
    "yaw": ("gb_yaw",),
    "pitch": ("gb_pitch",),
    "roll": ("gb_roll",),
}


def read_srt(path: Path) -> tuple[SensorSeries, ...]:
    """The series of a subtitle file; stamps are seconds since the video began.

    Raises:
        SequenceError: It cannot be read, or holds no telemetry.
    """
    _, *parts = _TIMING.split(read_text(path, SequenceError))
    cues = [parts[start : start + 5] for start in range(0, len(parts), 5)]
    stamps = np.array([3600 * int(h) + 60 * int(m) + int(s) + int(ms) / 1000 for h, m, s, ms, _ in cues], float)
    rows = [_values(text) for *_, text in cues]
    return sensor_series(
        path, stamps, {field: np.array([row.get(field, np.nan) for row in rows], float) for field in FIELDS}
    )


def _values(text: str) -> dict[str, float]:
    """The fields that the text of one subtitle has, by their names in FIELDS."""
    pairs = {key.lower(): float(number) for key, number in _PAIR.findall(text)}
    values = {field: pairs[key] for field, keys in _KEYS.items() for key in keys if key in pairs}
    if height := _H.search(text):
        values["height"] = float(height[1])
    if place := _GPS.search(text):
        # If the third number is an altitude in metres, latitude is the first; if it counts satellites, the second.
        first, second = float(place[1]), float(place[2])
        if place[4]:
            values |= {"latitude": first, "longitude": second, "altitude": float(place[3])}
        else:
            values |= {"latitude": second, "longitude": first}
    return values
