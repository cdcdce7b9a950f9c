"""How landmarks fared: when they began, how often they were looked for and how often measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Records:
    """Counts of N landmarks.

    Attributes:
        ids: (N,) ascending.
        born: (N,) index of the first frame.
        expected: (N,) in how many frames they were looked for.
        measured: (N,) in how many of these they were measured.
    """

    ids: NDArray[np.int64]
    born: NDArray[np.int64]
    expected: NDArray[np.int64]
    measured: NDArray[np.int64]

    @classmethod
    def none(cls) -> Self:
        """Of no landmarks."""
        none = np.empty(0, np.int64)
        return cls(none, none, none, none)

    def of(self, ids: NDArray[np.int64]) -> Records:
        """Those of these landmarks, in their order."""
        rows = np.searchsorted(self.ids, ids)
        return Records(self.ids[rows], self.born[rows], self.expected[rows], self.measured[rows])

    def counted(self, expected: NDArray[np.int64], measured: NDArray[np.int64]) -> Records:
        """After a frame in which these landmarks were looked for, and these measured."""
        return Records(
            self.ids,
            self.born,
            self.expected + np.isin(self.ids, expected),
            self.measured + np.isin(self.ids, measured),
        )

    def begun(self, ids: NDArray[np.int64], frame: int) -> Records:
        """With new landmarks, whose ids are higher than all that exist."""
        zero = np.zeros(len(ids), np.int64)
        return Records(
            np.concatenate([self.ids, ids]),
            np.concatenate([self.born, zero + frame]),
            np.concatenate([self.expected, zero]),
            np.concatenate([self.measured, zero]),
        )
