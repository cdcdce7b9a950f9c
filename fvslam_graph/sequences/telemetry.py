"""What a drone has recorded beside its video, brought to the video's clock and into the sequence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sensors import SensorKind, SensorSeries
from fvslam_graph.core.sequence import Ground, Sequence
from fvslam_graph.sequences.clock_offset import estimate_clock_offset
from fvslam_graph.sequences.drone_record import MAX_RECORD_GAP
from fvslam_graph.sequences.flight_record import read_flight_record
from fvslam_graph.sequences.ground import GIVEN_TILT, UAV_TILT, level_ground
from fvslam_graph.sequences.image_motion import measure_image_motion
from fvslam_graph.sequences.srt import read_srt

READERS: dict[str, Callable[[Path], tuple[SensorSeries, ...]]] = {".srt": read_srt, ".csv": read_flight_record}

# Seconds for which the first and the last height hold beyond the record. Otherwise, an offset that is off by a
# millisecond leaves the first frame without height, and a slow camera measures against that frame for long.
MAX_HOLD = 0.1


def add_telemetry(sequence: Sequence, file: Path, offset: float | None = None) -> Sequence:
    """The sequence with the sensors of a record; heights above the take-off are its heights above the ground.

    Args:
        sequence: Its heights, if it has any, are replaced.
        file: The record, `.srt` or `.csv`.
        offset: Seconds to add to the times of the record to have those since the first frame; estimated by the motion
            in the images where it is not given, and zero where these do not tell it clearly.

    Raises:
        SequenceError: The record cannot be read, or has another layout.
    """
    if (reader := READERS.get(file.suffix.lower())) is None:
        raise SequenceError(f"{file} is no telemetry: subtitles (.srt) and flight records (.csv) are read")
    recorded = reader(file)
    notes: tuple[str, ...] = ()
    if offset is None:
        offset, note = _offset(sequence, recorded, file)
        notes += (note,)
    shift = offset + float(sequence.stamps[0])
    sensors = tuple(replace(series, stamps=series.stamps + shift) for series in recorded)
    known = {series.kind: series for series in sensors}
    ground = sequence.ground
    if (heights := known.get(SensorKind.HEIGHT)) is not None:
        ground = _ground_below(heights, sequence.stamps)
        if not np.any(np.isfinite(ground.heights)):
            notes += (f"{file.name} knows no height above the take-off while the camera records",)
    if ground is not None and (attitude := known.get(SensorKind.ATTITUDE)) is not None:
        ground = _seen_by_gimbal(ground, attitude, sequence.stamps)
    return replace(sequence, ground=ground, sensors=sequence.sensors + sensors, notes=sequence.notes + notes)


def add_telemetry_beside(sequence: Sequence, video: Path, offset: float | None = None) -> Sequence:
    """The sequence of a video with the record of the same name beside it.

    Heights of `times.csv` stand; a record that cannot be read becomes a note.

    Raises:
        SequenceError: An offset is given, but there is no record.
    """
    files = {path.suffix.lower(): path for path in sorted(video.parent.iterdir()) if path.stem == video.stem}
    file = next((files[suffix] for suffix in READERS if suffix in files), None)
    if file is None:
        if offset is not None:
            raise SequenceError(f"{video} has no telemetry beside it whose clock could be off; give its file, too")
        return sequence
    try:
        added = add_telemetry(sequence, file, offset)
    except SequenceError as error:
        return replace(sequence, notes=(*sequence.notes, f"not used: {error}"))
    if (own := sequence.ground) is None or added.ground is None:
        return added
    kept = replace(own, normal=added.ground.normal, normal_sigma=added.ground.normal_sigma)
    return replace(added, ground=kept)


def _offset(sequence: Sequence, recorded: tuple[SensorSeries, ...], file: Path) -> tuple[float, str]:
    motion = measure_image_motion(sequence)
    found = estimate_clock_offset(motion._replace(stamps=motion.stamps - sequence.stamps[0]), recorded)
    if found is None:
        return 0.0, f"the images do not tell clearly how far the clock of {file.name} is off: 0 s is taken"
    return found.seconds, (
        f"{found.seconds:.2f} s are added to the times of {file.name}, by the motion in the images "
        f"(standard deviation {found.sigma:.2f} s)"
    )


def _ground_below(heights: SensorSeries, stamps: NDArray[np.float64]) -> Ground:
    """The ground at the height of the take-off, at the stamps (N,) of the frames; unknown where that is not below."""
    first, last = heights.stamps[[0, -1]]
    within = np.where((stamps > first - MAX_HOLD) & (stamps < last + MAX_HOLD), np.clip(stamps, first, last), stamps)
    metres = heights.interpolate(within, MAX_RECORD_GAP)[:, 0]
    metres[~(metres > 0)] = np.nan
    ground = level_ground(metres, UAV_TILT, f"{heights.source}, above the take-off")
    return replace(ground, height_sigma=float(np.nan_to_num(heights.sigmas[0, 0])))


def _seen_by_gimbal(ground: Ground, attitude: SensorSeries, stamps: NDArray[np.float64]) -> Ground:
    """The ground with the normal that the gimbal's pitch gives it: one for all frames, as uncertain as it changes."""
    pitch = attitude.interpolate(stamps, MAX_RECORD_GAP)[:, 1]
    pitch = pitch[np.isfinite(pitch)]
    if not len(pitch):
        return ground
    middle = float(np.median(pitch))
    normal = np.array([0.0, np.cos(middle), -np.sin(middle)])
    spread = float(np.sqrt(np.mean((pitch - middle) ** 2)))
    return replace(ground, normal=normal, normal_sigma=float(np.hypot(GIVEN_TILT, spread)))
