"""How the brightness of the same scene changes from one image to the next."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image
from fvslam_graph.core.quick import median

REDUCTION = 16  # so small that what moves between two images hardly matters
CLIPPED = (5, 250)  # grey levels beyond which brightness is not measured
EXPLAINED = 2 / 3  # of the change is left at most; with more, the scene has changed, not its exposure
MIN_SHIFT, MIN_RATIO = 2.0, 0.05  # grey levels of the mean, share of the contrast: less does not matter
_EXPOSURE_ITERATIONS = 6


def reduced(image: Image) -> NDArray[np.float64]:
    """The image at a sixteenth of its size, (H / 16, W / 16), from every fourth pixel."""
    height, width = image.shape
    size = max(1, width // REDUCTION), max(1, height // REDUCTION)
    small: NDArray[np.float64] = cv2.resize(image[::4, ::4], size, interpolation=cv2.INTER_AREA).astype(float)
    return small


def exposure_change(before: NDArray[np.float64], after: NDArray[np.float64]) -> tuple[float, float] | None:
    """Gain and offset (grey levels) that turn one reduced image into the next; None where they do not explain much.

    Least absolute residuals by reweighting.
    """
    usable = (np.minimum(before, after) > CLIPPED[0]) & (np.maximum(before, after) < CLIPPED[1])
    x, y = before[usable], after[usable]
    if len(x) < 16 or np.ptp(x) < 1:
        return None
    shift, ratio = float(y.mean() - x.mean()), float(y.std() / max(x.std(), 1e-6))
    if abs(shift) < MIN_SHIFT and abs(ratio - 1) < MIN_RATIO:
        return None
    change = median(np.abs(y - x))
    design, weight = np.column_stack([x, np.ones_like(x)]), np.ones_like(x)
    for _ in range(_EXPOSURE_ITERATIONS):
        weighted = design * weight[:, None]
        gain, offset = np.linalg.solve(weighted.T @ design, weighted.T @ y)
        residual = np.abs(y - gain * x - offset)
        weight = 1 / np.maximum(residual, 1.0)
    if not (gain > 0 and median(residual) < EXPLAINED * change and change > 1):
        return None
    return float(gain), float(offset)


def exposed(image: Image, gain: float, offset: float) -> Image:
    """The image in another exposure."""
    levels = np.rint(np.clip(gain * np.arange(256) + offset, 0, 255)).astype(np.uint8)
    changed: Image = cv2.LUT(image, levels)
    return changed
