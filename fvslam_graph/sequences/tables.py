"""Small text files of a recording: tables of stamps and poses, and calibration lines."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import CameraError, SequenceError, TrajectoryError
from fvslam_graph.core.text_files import read_text
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.core.trajectory_files import MAX_POSITION

MIN_STEP = 1e-6  # seconds; stamps since 1970 are held to a quarter of that
MIN_RATE, MAX_RATE = 0.1, 1e4  # frames a second, by the median


def read_table(path: Path, separator: str | None = None) -> list[list[str]]:
    """The words of each line, without empty lines and `#` comments; raises SequenceError."""
    lines = (line.strip() for line in read_text(path, SequenceError).splitlines())
    return [[word.strip() for word in line.split(separator)] for line in lines if line and not line.startswith("#")]


def read_listing(path: Path, columns: Sequence[int]) -> list[list[str]]:
    """The rows of a list of images: stamp, file name, with spaces or commas between, under a line of titles or none.

    Raises:
        SequenceError: There are none, or a row has another number of words than `columns` allow.
    """
    rows = [[word for word in re.split(r"[,;\s]+", " ".join(row)) if word] for row in read_table(path)]
    if rows and not re.match(r"[-+.\d]", rows[0][0]) and "stamp" in rows[0][0].lower():
        rows = rows[1:]
    if not rows or any(len(row) not in columns for row in rows):
        raise SequenceError(f"{path} should list the images as rows of time stamp and file name")
    return rows


def to_numbers(path: Path, rows: Sequence[Sequence[str]]) -> NDArray[np.float64]:
    """Rows of equally many words as numbers, (N, columns); raises SequenceError naming the row that is not."""
    for number, row in enumerate(rows, 1):
        if len(row) != len(rows[0]):
            raise SequenceError(f"{path}: row {number} has {len(row)} values, the first has {len(rows[0])}")
        try:
            [float(word) for word in row]
        except ValueError:
            raise SequenceError(f"{path}: row {number} is not numbers: '{' '.join(row)[:60]}'") from None
    return np.array(rows, float).reshape(len(rows), len(rows[0]) if rows else 0)


def read_stamps(path: Path) -> NDArray[np.float64]:
    """One stamp a line, (N,) seconds; raises SequenceError where they do not increase."""
    rows = read_table(path)
    if not rows:
        raise SequenceError(f"{path} holds no stamps")
    stamps = to_numbers(path, rows)[:, 0]
    require_increasing(path, stamps)
    return stamps


def require_increasing(path: Path, stamps: NDArray[np.float64]) -> None:
    """Raises SequenceError where stamps (N,) cannot be seconds that increase, naming the first that does not."""
    with np.errstate(invalid="ignore"):  # infinity less infinity
        steps = np.diff(stamps, prepend=-np.inf)
    good = np.isfinite(stamps) & (steps > MIN_STEP)
    if not np.all(good):
        row = int(np.argmin(good))
        problem = "not later than the one before" if np.isfinite(stamps[row]) else "not a finite number"
        if 0 < steps[row] <= MIN_STEP:
            problem = "less than a microsecond later than the one before; are they in the right unit?"
        raise SequenceError(f"{path}: stamp {row + 1} of {len(stamps)} is {problem}")
    if len(stamps) > 1 and not MIN_RATE <= (rate := 1 / float(np.median(np.diff(stamps)))) <= MAX_RATE:
        raise SequenceError(
            f"{path}: the stamps make {rate:.3g} frames a second, {MIN_RATE:g} to {MAX_RATE:g} are possible: "
            "are they in the right unit?"
        )


def even_stamps(frames: int, rate: float) -> NDArray[np.float64]:
    """Stamps of a steady camera, (frames,) seconds from 0, `rate` of them a second."""
    return np.arange(frames) / rate


def require_rows(path: Path, rows: int, last: int) -> None:
    """Raises SequenceError where the images, numbered up to `last`, go on after the rows of stamps end."""
    if last >= rows:
        raise SequenceError(
            f"{path} has {rows} rows, but the images are numbered up to {last}: "
            "complete it, or remove it and 10 Hz is assumed"
        )


def make_trajectory(path: Path, stamps: NDArray[np.float64], poses: Sequence[gtsam.Pose3]) -> Trajectory:
    """A trajectory whose errors name the file it comes from; raises TrajectoryError."""
    away = max((float(np.abs(pose.translation()).max()) for pose in poses), default=0.0)
    if not away <= MAX_POSITION:
        raise TrajectoryError(f"{path} has a pose with the number {away:g}, which is no place in metres")
    try:
        return Trajectory(stamps, tuple(poses))
    except TrajectoryError as error:
        raise TrajectoryError(f"{path}: {error}") from None


class CalibrationText:
    """A KITTI calibration file: lines of `key: numbers`; keys whose value is no numbers are left out."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.entries: dict[str, NDArray[np.float64]] = {}
        for line in read_text(path, SequenceError).splitlines():
            key, _, words = line.partition(":")
            try:
                self.entries[key.strip()] = np.array(words.split(), float)
            except ValueError:
                continue  # a date

    def numbers(self, key: str, *shape: int) -> NDArray[np.float64]:
        """The numbers of one key in the wanted shape; raises CameraError where they are not there."""
        values = self.entries.get(key, np.empty(0))
        if values.size != np.prod(shape) or not np.all(np.isfinite(values)):
            raise CameraError(f"{self.path} has no line '{key}:' with {np.prod(shape)} numbers")
        return values.reshape(shape)
