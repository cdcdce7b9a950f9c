"""FAST corners, spread over the image."""

from __future__ import annotations

import math
from operator import attrgetter

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.camera import Image
from fvslam_graph.config import FeatureSettings

BORDER = 8  # pixels at the rim where no patch fits
PER_CELL = 2  # corners in a grid cell: few, so that they are spread, and not one, so that texture counts too


def detect(image: Image, settings: FeatureSettings, taken: NDArray[np.float64] | None = None) -> NDArray[np.float32]:
    """The strongest FAST corners (Rosten and Drummond 2006) of every cell of a grid.

    Args:
        image: (H, W) uint8.
        settings: How many, how strong, how far apart.
        taken: (M, 2) pixels of points that exist: they use up places in their cell, and no new corner lies within
            `spacing` pixels of one.

    Returns:
        (N, 2) pixels; N is below `count` where the image has empty cells.
    """
    factor = 2**settings.octave
    height, width = (side // factor * factor for side in image.shape)
    small = cv2.resize(image[:height, :width], (width // factor, height // factor), interpolation=cv2.INTER_AREA)
    keypoints = cv2.FastFeatureDetector_create(settings.threshold, True).detect(small)
    if not keypoints:
        return np.empty((0, 2), np.float32)
    taken = np.empty((0, 2)) if taken is None else taken
    corners = cv2.KeyPoint_convert(keypoints)
    strength = np.fromiter(map(attrgetter("response"), keypoints), float, len(keypoints))
    column, row = corners.astype(np.intp).T
    kept = _free(small.shape, taken / factor, BORDER // factor, settings.spacing // factor)[row, column] > 0
    corners = (corners[kept] + np.float32(0.5)) * factor - np.float32(0.5)
    strength = strength[kept]

    cell = math.ceil(math.sqrt(width * height * PER_CELL / settings.count))
    columns = -(-width // cell)
    cells = _cells(corners, cell, columns)
    # By cell, strongest first; the last term only decides between equals.
    order = np.argsort(cells - strength / 256 + np.arange(len(cells)) / (512 * len(cells)))
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
