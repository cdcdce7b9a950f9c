"""Random numbers for many purposes from one seed."""

from __future__ import annotations

import numpy as np


def stream(seed: int, purpose: str, index: int = 0) -> np.random.Generator:
    """A generator of its own for each purpose and index, so that one use of random numbers never shifts another."""
    return np.random.default_rng([seed, index, *purpose.encode()])
