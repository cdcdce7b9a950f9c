"""Smooth, bounded, endless functions of time or place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Waves:
    """A sum of sinusoids; it has all derivatives, and its value at any argument costs the same.

    Attributes:
        amplitudes, lengths: (K,) each; `lengths` are periods, in the unit of the argument.
        phases: (K,) radians.
    """

    amplitudes: NDArray[np.float64]
    lengths: NDArray[np.float64]
    phases: NDArray[np.float64]

    @classmethod
    def random(cls, rng: np.random.Generator, *parts: tuple[float, float]) -> Waves:
        """Sinusoids of the given (amplitude, length) with random phases."""
        amplitudes, lengths = np.array(parts, float).T
        return cls(amplitudes, lengths, rng.uniform(0, 2 * np.pi, len(parts)))

    def __call__(self, x: ArrayLike, derivative: int = 0) -> NDArray[np.float64]:
        """The value, or a derivative, at x of any shape."""
        rates = 2 * np.pi / self.lengths
        angles = np.asarray(x, float)[..., None] * rates + self.phases + derivative * np.pi / 2
        total: NDArray[np.float64] = (self.amplitudes * rates**derivative * np.sin(angles)).sum(axis=-1)
        return total
