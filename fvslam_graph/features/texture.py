"""How well the texture around a point tells where the point went."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image

TEXTURE_WINDOW = 5  # pixels of the reduced image
EDGE = 10.0  # times more texture across an edge than along it: there, the variance along it has doubled
MIN_TEXTURE_ALONG = 0.01  # of the texture across an edge: the least that any is taken to have along it


@dataclass(frozen=True)
class Texture:
    """An image and its structure tensors.

    Attributes:
        image: (H, W) reduced by `factor`.
        factor: Pixels of the original per pixel of this.
        tensors: (H, W, 3) sums of squared gradients xx, xy and yy around each pixel.
    """

    image: Image
    factor: int
    tensors: NDArray[np.float32]

    @classmethod
    def of(cls, image: Image, octave: int) -> Texture:
        """Measure an image that is halved `octave` times."""
        factor = 2**octave
        height, width = (side // factor * factor for side in image.shape)
        small = cv2.resize(image[:height, :width], (width // factor, height // factor), interpolation=cv2.INTER_AREA)
        x, y = cv2.spatialGradient(small)
        products = (cv2.multiply(a, b, dtype=cv2.CV_32F) for a, b in ((x, x), (x, y), (y, y)))
        return cls(
            small,
            factor,
            cv2.merge([cv2.boxFilter(product, -1, (TEXTURE_WINDOW, TEXTURE_WINDOW)) for product in products]),
        )

    def strength(self, pixels: NDArray[np.intp]) -> NDArray[np.float64]:
        """The texture (N,) along the direction in which pixels (N, 2) of the reduced image have least (Shi, Tomasi)."""
        return self._weak(*self.tensors[pixels[:, 1], pixels[:, 0]].T.astype(float))[0]

    def displacement_covariances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariances (N, 2, 2) of how far points (N, 2) seem to move, in variances of one on a corner.

        Along an edge there is little that tells how far it went (the aperture problem), and alignments slide along it.
        """
        height, width = self.image.shape
        column, row = ((points + 0.5) / self.factor).astype(np.intp).T
        xx, xy, yy = self.tensors[row.clip(0, height - 1), column.clip(0, width - 1)].T.astype(float)
        weak, strong = self._weak(xx, xy, yy)
        excess = (strong / np.maximum(weak, MIN_TEXTURE_ALONG * strong + 1e-9) / EDGE) ** 4
        # (S - weak) / (strong - weak) projects on the direction across, and its complement on that along the edge.
        share = excess / np.maximum(strong - weak, 1e-9)
        along = np.stack([strong - xx, -xy, -xy, strong - yy], axis=1) * share[:, None]
        covariances: NDArray[np.float64] = np.eye(2) + along.reshape(-1, 2, 2)
        return covariances

    @staticmethod
    def _weak(
        xx: NDArray[np.float64], xy: NDArray[np.float64], yy: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Eigenvalues, the smaller ones first."""
        middle, radius = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
        return middle - radius, middle + radius
