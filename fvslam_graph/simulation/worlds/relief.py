"""Periodic hills and bumps."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.simulation.worlds.patterns import noise
from fvslam_graph.simulation.worlds.ripmap import Grey

CELL = 0.27  # metres
GRID_CELLS = 1024
PERIOD = CELL * GRID_CELLS  # 276 m
_BUMPS = 400
_BUMP_RADIUS = 1.5  # metres


class Relief:
    """Heights above a mean plane: a periodic grid, linear between its nodes, with zero mean.

    Attributes:
        highest: Height of the highest point, metres.
        steepest: Slope of the steepest place.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        heights = noise(rng, (GRID_CELLS, GRID_CELLS), (64, 0.30), (32, 0.25)) + _bumps(rng)
        heights -= heights.mean()
        slope_x = (np.roll(heights, -1, axis=1) - heights) / CELL
        slope_y = (np.roll(heights, -1, axis=0) - heights) / CELL
        tones = noise(rng, heights.shape, (128, 8), (32, 5)) + 60 * (slope_x + slope_y)
        self.highest = float(heights.max())
        self.steepest = float(np.hypot(slope_x, slope_y).max())
        self._heights, self._tones = (np.pad(grid, (0, 1), mode="wrap") for grid in (heights, tones))

    def height(self, x: Grey, y: Grey) -> Grey:
        """Metres above the mean plane at places (H, W), metres."""
        return _interpolate(self._heights, x, y)

    def tone(self, x: Grey, y: Grey) -> Grey:
        """Grey values by which the ground is brighter there: its cover, and how the sun falls on its slopes."""
        return _interpolate(self._tones, x, y)


def _bumps(rng: np.random.Generator) -> Grey:
    """Mounds and pits, sharper than the hills."""
    grid = np.zeros((GRID_CELLS, GRID_CELLS), np.float32)
    row, column = rng.integers(0, GRID_CELLS, (2, _BUMPS))
    grid[row, column] = rng.choice([-1, 1], _BUMPS) * rng.uniform(0.25, 0.5, _BUMPS)
    sigma = _BUMP_RADIUS / CELL
    smooth: Grey = cv2.GaussianBlur(np.pad(grid, 32, mode="wrap"), (0, 0), sigma)[32:-32, 32:-32]
    return smooth * np.float32(2 * np.pi * sigma**2)


def _interpolate(grid: NDArray[np.float32], x: Grey, y: Grey) -> Grey:
    column, row = (c / np.float32(CELL) - GRID_CELLS * np.floor(c / np.float32(PERIOD)) for c in (x, y))
    values: Grey = cv2.remap(grid, column, row, cv2.INTER_LINEAR)
    return values
