"""Files of a recording: which there are, in which order, what time their names tell, and words for notes on them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.sequences.tables import require_increasing

IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".bmp", ".tif", ".tiff", ".webp"}
MAX_NUMBER = 9_999_999  # of an image; more is a stamp
MAX_FILES_LISTED = 10  # runs of numbers that are listed
EPOCH = (946_684_800, 4_102_444_800)  # seconds since 1970 of the years 2000 and 2100
UNITS = {"seconds": 1, "milliseconds": 10**3, "microseconds": 10**6, "nanoseconds": 10**9}

_DIGITS_OR_TEXT = re.compile(r"(\d+)|(\D+)")
_NUMBER = re.compile(r"(.*?)(\d+(?:\.\d+)?)")


def image_files(folder: Path) -> list[Path]:
    """The images in a folder in natural order: 2.png comes before 10.png, and 1.05.png before 1.1.png."""
    files = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".") and path.is_file()
    ]
    values = _decimals(files)
    if values is not None:
        return sorted(files, key=lambda path: (values[path], path.name))
    return sorted(
        files, key=lambda path: [(int(digits or -1), text) for digits, text in _DIGITS_OR_TEXT.findall(path.name)]
    )


def stamps_in_names(files: Sequence[Path]) -> tuple[NDArray[np.float64], str] | None:
    """Seconds since 1970, (N,), that the names of all files tell, and the unit that they do it in; None if not."""
    values = _decimals(files)
    for name, unit in UNITS.items():
        if values and all(EPOCH[0] <= value / unit <= EPOCH[1] for value in values.values()):
            stamps = np.array([float(values[path] / unit) for path in files])
            try:
                require_increasing(files[0].parent, stamps)
            except SequenceError:
                return None
            return stamps, name
    return None


def _decimals(files: Sequence[Path]) -> dict[Path, Decimal] | None:
    """The decimal that each name ends with, if that is what they are: chapters 1.9, 1.10 and dates are not."""
    matches = [_NUMBER.fullmatch(path.stem) for path in files]
    if not all(matches) or len({match[1] for match in matches if match}) != 1:
        return None
    numbers = [match[2] for match in matches if match]
    fractions = [number.partition(".")[2] for number in numbers]
    # A decimal that is not padded to the length of the others does not end in zero, but for 1.0.
    if len(set(map(len, fractions))) > 1 and any(len(text) > 1 and text.endswith("0") for text in fractions):
        return None
    return {path: Decimal(number) for path, number in zip(files, numbers, strict=True)}


def numbered_images(folder: Path, prefix: str = "") -> dict[int, Path]:
    """The images named `prefix` and a number, by number and in its order.

    Raises:
        SequenceError: There is none, or a number that is too large for one.
    """
    name = re.compile(re.escape(prefix) + r"(\d+)")
    files = {int(match[1]): path for path in image_files(folder) if (match := name.fullmatch(path.stem))}
    if not files:
        raise SequenceError(f"{folder} holds no images named {prefix}000000.png, {prefix}000001.png, ...")
    if max(files) > MAX_NUMBER:
        raise SequenceError(
            f"{folder}: images should be numbered {prefix}000000.png, {prefix}000001.png, ...; "
            f"{files[max(files)].name} is no such number"
        )
    return dict(sorted(files.items()))


def count_of(number: int, noun: str) -> str:
    """`1 image is`, `2 images are`: the subject of a note."""
    return f"{number} {noun} is" if number == 1 else f"{number} {noun}s are"


def ranges(numbers: Sequence[int]) -> str:
    """Increasing numbers for the eye: [1, 2, 3, 7] is `1-3, 7`; the first ten runs of many."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1][1:] = [number]
        else:
            runs.append([number])
    listed = ", ".join("-".join(map(str, run)) for run in runs[:MAX_FILES_LISTED])
    return listed + (f" and {len(runs) - MAX_FILES_LISTED} more such" if len(runs) > MAX_FILES_LISTED else "")


def only_one(folder: Path, found: Sequence[Path], noun: str) -> Path:
    """The one candidate; raises SequenceError where there is none, and one that lists them where there are several."""
    if not found:
        raise SequenceError(f"{folder} holds no {noun}")
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise SequenceError(f"{folder} holds {len(found)} {noun}s, give one of them: {names}")
    return found[0]
