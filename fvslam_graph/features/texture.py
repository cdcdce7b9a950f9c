"""How well the texture around a point tells where the point went."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image

WINDOW = 5  # pixels of the reduced image
EDGE = 10.0  # times more texture across an edge than along it: there, the variance along it has doubled
MIN_TEXTURE_ALONG = 0.01  # of the texture across an edge: the least that any is taken to have along it


@dataclass(frozen=True)
class Texture:
    """An image and how much texture it has.

    Attributes:
        image: (H, W) reduced by `factor`.
        factor: Pixels of the original per pixel of this.
        strength: (H, W) texture around each pixel along the direction in which there is least (Shi, Tomasi).
    """

    image: Image
    factor: int
    strength: NDArray[np.float32]

    @classmethod
    def of(cls, image: Image, octave: int) -> Texture:
        """Measure an image that is halved `octave` times."""
        factor = 2**octave
        height, width = (side // factor * factor for side in image.shape)
        small = cv2.resize(image[:height, :width], (width // factor, height // factor), interpolation=cv2.INTER_AREA)
        return cls(small, factor, cv2.cornerMinEigenVal(small, WINDOW))

    def displacement_covariances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariances (N, 2, 2) of how far points (N, 2) seem to move, in variances of one on a corner.

        Along an edge there is little that tells how far it went (the aperture problem), and alignments slide along it.
        """
        middles = np.floor((points + 0.5) / self.factor)
        x, y = gradients_around(self.image, middles, WINDOW)
        xx, xy, yy = ((a * b).sum(axis=0).astype(float) for a, b in ((x, x), (x, y), (y, y)))
        middle, radius = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
        weak, strong = middle - radius, middle + radius
        excess = (strong / np.maximum(weak, MIN_TEXTURE_ALONG * strong + 1e-9) / EDGE) ** 4
        # (S - weak) / (strong - weak) projects on the direction across, and its complement on that along the edge.
        share = excess / np.maximum(strong - weak, 1e-9)
        along = np.stack([strong - xx, -xy, -xy, strong - yy], axis=1) * share[:, None]
        covariances: NDArray[np.float64] = np.eye(2) + along.reshape(-1, 2, 2)
        return covariances


def gradients_around(
    image: Image, middles: NDArray[np.floating], side: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Gradients (Sobel) along x and y in patches around whole pixels (N, 2), (side^2, N) each, row by row.

    Where a patch would reach over the rim of the image, it is the nearest one that does not.
    """
    if not len(middles):  # as in images smaller than a patch
        return np.empty((side**2, 0), np.float32), np.empty((side**2, 0), np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(image, (side + 2, side + 2))
    column, row = (middles.astype(np.intp) - side // 2 - 1).clip(0, np.subtract(windows.shape[1::-1], 1)).T
    patches = windows[row, column].transpose(1, 2, 0).astype(np.float32, order="C")
    down = patches[:-2] + 2 * patches[1:-1] + patches[2:]
    across = patches[:, :-2] + 2 * patches[:, 1:-1] + patches[:, 2:]
    x, y = down[:, 2:] - down[:, :-2], across[2:] - across[:-2]
    return x.reshape(side**2, -1), y.reshape(side**2, -1)
