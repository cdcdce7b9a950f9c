"""Text files of trajectories: which number of a row is what, in TUM's, KITTI's and the ASL layout."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import TrajectoryError
from fvslam_graph.core.text_files import read_text

MAX_FILE_SIZE = 200_000_000  # bytes, a million poses and more
SINCE_1970 = 1e17  # larger stamps are nanoseconds: as seconds, they were older than the universe
MAX_POSITION = 1e15  # m, a tenth of a light year; a path through positions beyond it has no length
FAR_APART = 1e5  # whole numbers that grow by more from row to row are nanoseconds: as seconds, they were a day apart


class Layout(Enum):
    """Which numbers of a row are position and quaternion x y z w, or the 3x4 matrix."""

    TUM = (1, 2, 3, 4, 5, 6, 7)
    ASL = (1, 2, 3, 5, 6, 7, 4)  # EuRoC, TUM-VI: the quaternion is w x y z; more may follow
    KITTI = tuple(range(12))


@dataclass(frozen=True)
class PoseRows:
    """The rows of a file whose numbers are all finite.

    Attributes:
        numbers: (N,) which rows of the file these are, from 0.
        count: How many rows the file has.
        stamps: (N,) seconds; None for KITTI, which has none.
        poses: (N, 7) position (m) and quaternion x y z w as written, or (N, 12) rows of KITTI's 3x4 matrices.
        notes: What was left out or guessed, one sentence each.
    """

    numbers: NDArray[np.int64]
    count: int
    stamps: NDArray[np.float64] | None
    poses: NDArray[np.float64]
    notes: tuple[str, ...]


def read_rows(path: Path, unfinished: bool = False, known: Layout | None = None) -> PoseRows:
    """Read a file of any of the layouts; rows with a number that is not finite, as of a lost target, are left out.

    Args:
        path: A text file in UTF-8, with or without byte order mark; numbers are set apart by blanks or commas.
        unfinished: Leave out a last line without its line end: its writer was stopped in the middle.
        known: The layout, where the folder that the file is in tells; else header and numbers tell.

    Raises:
        TrajectoryError: It cannot be read, holds no poses, or its rows are none of a known layout.
    """
    text = read_text(path, TrajectoryError, MAX_FILE_SIZE)
    header, lines = _split(text[: text.rfind("\n") + 1] if unfinished else text)
    if not lines:
        raise TrajectoryError(f"{path} holds no poses: no line begins with a number")
    layout, notes = (known, []) if known and len(_words(lines[0])) >= 8 else _layout(path, header, lines)
    rows = _numbers(path, lines, columns=max(layout.value) + 1)
    finite = np.isfinite(rows).all(axis=1)
    numbers, values = np.flatnonzero(finite), rows[finite]
    if lost := len(rows) - len(values):
        notes.append(f"{path.name}: {lost} of {len(rows)} poses have a number that is not finite and are left out")
    if not len(values):
        raise TrajectoryError(f"{path}: each of the {len(rows)} poses has a number that is not finite")
    stamps = None if layout is Layout.KITTI else values[:, 0]
    if stamps is not None:
        if layout is Layout.ASL and _is_whole(lines[0]):
            stamps = stamps / 1e9
        elif np.median(stamps) > SINCE_1970:
            stamps = stamps / 1e9
            notes.append(f"{path.name}: the stamps are read as nanoseconds")
        if (latest := np.abs(stamps).max()) > SINCE_1970:
            raise TrajectoryError(f"{path} has the stamp {latest:g}, which is no time in seconds")
    poses = values[:, layout.value]
    if (away := np.abs(poses).max()) > MAX_POSITION:
        raise TrajectoryError(f"{path} has a pose with the number {away:g}, which is no place in metres")
    return PoseRows(numbers, len(rows), stamps, poses, tuple(notes))


def _split(text: str) -> tuple[str, list[str]]:
    """The header, which is the last comment or line of words before the data, and the lines of data."""
    header, lines = "", list[str]()
    for line in text.splitlines():
        data, _, remark = line.partition("#")
        words = _words(data)
        if words and (lines or _is_number(words[0])):
            lines.append(data)
        elif not lines and line.strip():
            header = data.strip() or remark
    return header, lines


def _layout(path: Path, header: str, lines: list[str]) -> tuple[Layout, list[str]]:
    """The layout, and a note where it is a guess: a header names the quaternion, or else numbers have to tell."""
    columns = len(_words(lines[0]))
    names = [name.strip().lower() for name in header.split("," if "," in header else None)]
    parts = {name: match[1] for name in names if (match := re.match(r"(?:q|ori|rot)[\w.]*([wxyz])\b", name))}
    order = "".join(parts.values())
    if len(parts) == 4 and len(names) == columns and (begin := names.index(next(iter(parts)))) != 4:
        raise TrajectoryError(
            f"{path}: its header puts the quaternion in columns {begin + 1} to {begin + 4}, not 5 to 8"
        )
    if columns == 12 and not order:
        return Layout.KITTI, []
    if columns >= 8 and order in ("xyzw", "wxyz"):
        return Layout.ASL if order == "wxyz" else Layout.TUM, []
    if columns >= 8 and "," in lines[0] and _are_nanoseconds(lines):
        return Layout.ASL, [f"{path.name} has no header: its quaternions are read as w x y z, as EuRoC writes them"]
    if columns == 8:
        return Layout.TUM, []
    raise TrajectoryError(f"{path} is neither a TUM file (8 numbers a line) nor a KITTI file (12): it has {columns}")


def _are_nanoseconds(lines: list[str]) -> bool:
    if not (_is_whole(lines[0]) and _is_whole(lines[-1])):
        return False
    first, last = (float(_words(line)[0]) for line in (lines[0], lines[-1]))
    return first > SINCE_1970 or last - first > FAR_APART * len(lines)


def _numbers(path: Path, lines: list[str], columns: int) -> NDArray[np.float64]:
    """The first columns of all rows, which must be equally long."""
    expected = len(_words(lines[0]))
    rows = np.empty((len(lines), columns))
    for number, line in enumerate(lines, 1):
        words = _words(line)
        if len(words) != expected:
            raise TrajectoryError(f"{path}: pose {number} has {len(words)} numbers instead of {expected}")
        try:
            rows[number - 1] = [float(word) for word in words[:columns]]
        except ValueError:
            raise TrajectoryError(f"{path}: pose {number} is not a row of numbers: {line.strip()[:60]!r}") from None
    return rows


def _words(line: str) -> list[str]:
    return line.replace(",", " ").split()


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _is_whole(line: str) -> bool:
    return _words(line)[0].isdecimal()
