"""landmarks.csv: what became of every landmark in every frame of visual SLAM."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.slam_estimate import MatchOutcome, SlamEstimate
from fvslam_graph.core.text_files import OWN_MAX_SIZE, read_text

NEW = "new"  # in place of an outcome: begins at this frame
_NUMBERS = (
    *("expected_u", "expected_v", "ellipse_uu", "ellipse_uv", "ellipse_vv", "u", "v"),
    *("x", "y", "z", "cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"),
)
LANDMARK_COLUMNS = ("frame", "id", "outcome", "age", *_NUMBERS)


def landmark_columns(slam: SlamEstimate) -> dict[str, NDArray[np.generic]]:
    """The columns of a frame but `frame`: what was looked for (pixels), and what is kept (m, in the camera).

    A landmark that was not found has no pixel, one that was dropped no position: NaN, and -1 as its age.
    """
    matches, kept = slam.matches, slam.landmarks
    ids = np.union1d(matches.ids, kept.ids)
    values = np.full((len(ids), len(_NUMBERS)), np.nan)
    outcomes = np.full(len(ids), NEW, dtype=object)
    ages = np.full(len(ids), -1)
    new = np.searchsorted(ids, kept.ids[kept.ages == 0])
    values[new, 5:7] = kept.pixels[kept.ages == 0]
    rows = np.searchsorted(ids, matches.ids)
    ellipses = matches.ellipses.reshape(-1, 4)[:, [0, 1, 3]]
    values[rows, :7] = np.hstack([matches.expected, ellipses, matches.pixels])
    outcomes[rows] = [MatchOutcome(outcome).name.lower() for outcome in matches.outcome]
    rows = np.searchsorted(ids, kept.ids)
    values[rows, 7:] = np.hstack([kept.points, kept.covariances.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]])
    ages[rows] = kept.ages
    return {"id": ids, "outcome": outcomes, "age": ages} | dict(zip(_NUMBERS, values.T, strict=True))


def landmark_rows(slam: SlamEstimate) -> str:
    """The lines of a frame; cells are empty where `landmark_columns` has no number."""
    columns = landmark_columns(slam)
    values = np.column_stack([columns[name] for name in _NUMBERS])
    lines = []
    for identity, outcome, age, numbers in zip(*(columns[n] for n in ("id", "outcome", "age")), values, strict=True):
        cells = ("" if np.isnan(number) else f"{number:.6g}" for number in numbers)
        lines.append(",".join((str(slam.index), str(identity), outcome, "" if age < 0 else str(age), *cells)) + "\n")
    return "".join(lines)


def landmark_points(columns: dict[str, NDArray[Any]]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions in the camera, (N, 3), m, and their covariances, (N, 3, 3); NaN where there is none."""
    points = np.column_stack([columns[name] for name in "xyz"])
    entries = np.column_stack([columns[f"cov_{name}"] for name in ("xx", "xy", "xz", "yy", "yz", "zz")])
    return points, entries[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)


@dataclass(frozen=True)
class Observations:
    """Landmarks where they were found in the images, in the order of frames.

    Attributes:
        frames: (K,) in which frame,
        ids: (K,) which landmark,
        pixels: (K, 2) where.
    """

    frames: NDArray[np.int64]
    ids: NDArray[np.int64]
    pixels: NDArray[np.float64]

    def select(self, rows: NDArray[np.bool_]) -> Observations:
        """Some of them."""
        return Observations(self.frames[rows], self.ids[rows], self.pixels[rows])


def read_observations(path: Path) -> Observations:
    """All observations that agree with the map, and those that landmarks begin with.

    Raises:
        ValueError: The file is damaged.
    """
    good = {NEW, *(outcome.name.lower() for outcome in MatchOutcome if outcome >= MatchOutcome.INLIER)}
    text = read_text(path, ResultsError, OWN_MAX_SIZE)
    rows = [line.split(",") for line in text[: text.rfind("\n") + 1].splitlines()[1:]]
    if odd := [row for row in rows if len(row) != len(LANDMARK_COLUMNS)]:
        raise ValueError(f"it has a line of {len(odd[0])} instead of {len(LANDMARK_COLUMNS)} cells")
    rows = [row for row in rows if row[LANDMARK_COLUMNS.index("outcome")] in good]
    u = LANDMARK_COLUMNS.index("u")
    return Observations(
        np.array([row[0] for row in rows], dtype=np.int64),
        np.array([row[1] for row in rows], dtype=np.int64),
        np.array([row[u : u + 2] for row in rows], dtype=np.float64).reshape(-1, 2),
    )


def landmark_frames(path: Path) -> NDArray[np.int64]:
    """The frames that have landmarks, in order.

    Raises:
        ValueError: The file is damaged.
    """
    lines = read_text(path, ResultsError, OWN_MAX_SIZE).splitlines()[1:]
    return np.unique(np.array([line.partition(",")[0] for line in lines], dtype=str).astype(np.int64))


def read_landmarks(path: Path, frame: int) -> dict[str, NDArray[np.generic]]:
    """The columns of one frame; NaN where a cell is empty.

    Raises:
        ValueError: The file is damaged.
    """
    lines = read_text(path, ResultsError, OWN_MAX_SIZE).splitlines()[1:]
    return _columns([line for line in lines if line.startswith(f"{frame},")])


def read_landmarks_by_frame(path: Path) -> dict[int, dict[str, NDArray[np.generic]]]:
    """The columns of each frame, as by `read_landmarks`; the last line is left out where it is not whole.

    Raises:
        ValueError: The file is damaged.
    """
    text = read_text(path, ResultsError, OWN_MAX_SIZE)
    lines = text[: text.rfind("\n") + 1].splitlines()[1:]
    frames = groupby(lines, key=lambda line: int(line.partition(",")[0]))
    return {frame: _columns(list(rows)) for frame, rows in frames}


def _columns(lines: list[str]) -> dict[str, NDArray[np.generic]]:
    cells = np.array([line.split(",") for line in lines]).reshape(-1, len(LANDMARK_COLUMNS))
    columns: dict[str, NDArray[np.generic]] = {"outcome": cells[:, LANDMARK_COLUMNS.index("outcome")]}
    for name in ("id", *_NUMBERS):
        column = cells[:, LANDMARK_COLUMNS.index(name)]
        columns[name] = np.where(column == "", "nan", column).astype(float)
    return columns
