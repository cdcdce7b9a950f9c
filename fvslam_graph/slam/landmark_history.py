"""How landmarks fared: when they began, how often they were looked for and how often measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

NO_TRACK = -1


@dataclass(frozen=True)
class LandmarkHistory:
    """Counts of N landmarks.

    Attributes:
        ids: (N,) ascending.
        born: (N,) index of the first frame.
        expected: (N,) in how many frames they were looked for.
        measured: (N,) in how many of these they were measured.
        tracks: (N,) number of the track by which odometry follows them; NO_TRACK for those that began without one.
    """

    ids: NDArray[np.int64]
    born: NDArray[np.int64]
    expected: NDArray[np.int64]
    measured: NDArray[np.int64]
    tracks: NDArray[np.int64]

    @classmethod
    def none(cls) -> Self:
        """The history of no landmarks."""
        none = np.empty(0, np.int64)
        return cls(none, none, none, none, none)

    def of(self, ids: NDArray[np.int64]) -> LandmarkHistory:
        """Those of these landmarks, in their order."""
        rows = np.searchsorted(self.ids, ids)
        return LandmarkHistory(
            self.ids[rows], self.born[rows], self.expected[rows], self.measured[rows], self.tracks[rows]
        )

    def counted(
        self, ids: NDArray[np.int64], expected: NDArray[np.bool_], measured: NDArray[np.bool_]
    ) -> LandmarkHistory:
        """After a frame in which some of the landmarks `ids`, (K,), were expected, (K,), and some measured, (K,)."""
        rows, more, hits = np.searchsorted(self.ids, ids), self.expected.copy(), self.measured.copy()
        more[rows] += expected
        hits[rows] += measured
        return replace(self, expected=more, measured=hits)

    def begun(self, ids: NDArray[np.int64], frame: int, tracks: NDArray[np.int64]) -> LandmarkHistory:
        """The history with new landmarks, (K,), whose ids are higher than all that exist, and their tracks, (K,)."""
        zero = np.zeros(len(ids), np.int64)
        return LandmarkHistory(
            np.concatenate([self.ids, ids]),
            np.concatenate([self.born, zero + frame]),
            np.concatenate([self.expected, zero]),
            np.concatenate([self.measured, zero]),
            np.concatenate([self.tracks, tracks]),
        )
