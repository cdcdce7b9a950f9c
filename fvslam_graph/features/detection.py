"""FAST corners, spread over the image."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.config import FeatureSettings
from fvslam_graph.features.texture import Texture

BORDER = 8  # pixels at the rim where no patch fits
PLENTY = 8  # corners for each that is wanted
PER_CELL = 2  # corners in a grid cell: few, so that they are spread, and not one, so that texture counts too


def detect(
    texture: Texture, settings: FeatureSettings, taken: NDArray[np.float64] | None = None
) -> NDArray[np.float32]:
    """FAST corners (Rosten and Drummond 2006), of every cell of a grid those with most texture in any direction.

    Args:
        texture: Of the image.
        settings: How many, how strong, how far apart.
        taken: (M, 2) pixels of points that exist: they use up places in their cell, and no new corner lies within
            `spacing` pixels of one.

    Returns:
        (N, 2) pixels; N is below `count` where the image has empty cells.
    """
    small, factor = texture.image, texture.factor
    height, width = (side * factor for side in small.shape)
    keypoints = ()
    for threshold in (2 * settings.threshold, settings.threshold):  # where there are plenty, weak ones only cost time
        if len(keypoints) < PLENTY * settings.count:
            keypoints = cv2.FastFeatureDetector_create(min(threshold, 255), True).detect(small)
    if not keypoints:
        return np.empty((0, 2), np.float32)
    taken = np.empty((0, 2)) if taken is None else taken
    corners = cv2.KeyPoint_convert(keypoints)
    column, row = corners.astype(np.intp).T
    kept = _free(small.shape, taken / factor, BORDER // factor, settings.spacing // factor)[row, column] > 0
    strength = texture.strength[row[kept], column[kept]]
    corners = (corners[kept] + np.float32(0.5)) * factor - np.float32(0.5)

    cell = math.ceil(math.sqrt(width * height * PER_CELL / settings.count))
    columns = -(-width // cell)
    cells = _cells(corners, cell, columns)
    # By cell, and the strongest first; stable, so that it is the same on all processors.
    order = np.argsort(cells - strength / (strength.max(initial=0.0) + 1.0), kind="stable")
    cells = cells[order]
    first = np.flatnonzero(np.diff(cells, prepend=-1))
    rank = np.arange(len(cells)) - np.repeat(first, np.diff(first, append=len(cells)))
    used = np.bincount(_cells(taken, cell, columns), minlength=columns * -(-height // cell))
    best: NDArray[np.float32] = corners[order[rank + used[cells] < PER_CELL]]
    return best


def _free(shape: tuple[int, ...], taken: NDArray[np.float64], border: int, spacing: int) -> NDArray[np.uint8]:
    """A mask (H, W) that is 1 where a new corner may lie: off the border and `spacing` pixels from all taken ones."""
    free = np.ones(shape, np.uint8)
    column, row = np.minimum(taken.astype(np.intp), (shape[1] - 1, shape[0] - 1)).T
    free[row, column] = 0
    side = 2 * spacing + 1
    free = cv2.erode(free, np.ones((side, side), np.uint8), borderValue=1)
    inside: NDArray[np.uint8] = np.zeros(shape, np.uint8)
    inside[border:-border, border:-border] = free[border:-border, border:-border]
    return inside


def _cells(points: NDArray[np.floating], cell: int, columns: int) -> NDArray[np.intp]:
    grid = points.astype(np.intp) // cell
    return grid[:, 1] * columns + grid[:, 0]
