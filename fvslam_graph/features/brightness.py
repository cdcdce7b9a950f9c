"""Brightness against that of the surroundings, so that exposure, vignetting and lamps do not move points."""

from __future__ import annotations

import cv2
import numpy as np

from fvslam_graph.core.camera import Image

REDUCTION = 8  # mean brightness is taken from the image at an eighth of its size
DARK = 8.0  # grey levels of surroundings below which differences are not enlarged further: there, they are noise
MIDDLE = 128.0  # grey level of what is as bright as its surroundings


def relative_brightness(image: Image, reach: int) -> Image:
    """The image divided by the mean brightness around each pixel (flat-field correction).

    Lucas and Kanade take a change of brightness for a motion. What changes it slowly over the image cancels here: the
    exposure, the corners of a lens that are darker, lamps that flicker row by row.

    Args:
        image: (H, W) uint8.
        reach: Pixels, side of the largest patch that is to be aligned; what is much larger is lost.
    """
    height, width = image.shape
    rows, columns = max(1, height // REDUCTION), max(1, width // REDUCTION)
    whole = image[: rows * REDUCTION, : columns * REDUCTION]  # by a whole number, which is ten times as fast
    small = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
    # As wide as a square of that side, but without an edge at which what enters counts at once.
    mean = cv2.GaussianBlur(small.astype(np.float32), (0, 0), reach / REDUCTION / 4, borderType=cv2.BORDER_REPLICATE)
    gain = cv2.resize(np.float32(MIDDLE) / (mean + np.float32(DARK)), (width, height), interpolation=cv2.INTER_LINEAR)
    relative: Image = cv2.multiply(image, gain, dtype=cv2.CV_8U)
    return relative
