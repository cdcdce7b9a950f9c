"""Images turned back to how the keyframe was held: patches that are only shifted get lost where a camera rolls."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image

MIN_TURN = 0.05  # rad, by which the rim of a patch goes half a pixel; what less of it makes tracks err is known


@dataclass(frozen=True)
class Turn:
    """How an image is turned against the keyframe about the optical axis, and shifted with it.

    Attributes:
        angle: Radians, from x to y.
        affine: (2, 3) from pixels of the image that is turned back to those of the image.
    """

    angle: float
    affine: NDArray[np.float64]

    @staticmethod
    def between(keyframe: NDArray[np.float32], expected: NDArray[np.float32]) -> Turn | None:
        """The turn that leads points (N, 2) of the keyframe nearest to where they are expected; None if it is small."""
        here, there = keyframe.mean(axis=0, dtype=float), expected.mean(axis=0, dtype=float)
        a, b = keyframe - here, expected - there
        angle = float(np.arctan2(a[:, 0] @ b[:, 1] - a[:, 1] @ b[:, 0], np.vdot(a, b)))
        R = gtsam.Rot2(angle).matrix()
        return Turn(angle, np.column_stack([R, there - R @ here])) if abs(angle) > MIN_TURN else None

    def upright(self, image: Image) -> Image:
        """The image, turned back."""
        height, width = image.shape
        return np.asarray(
            cv2.warpAffine(
                image,
                self.affine,
                (width, height),
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_REPLICATE,
            )
        )

    def into_upright(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Where points (N, 2) of the image are when it is turned back."""
        return np.asarray((points - self.affine[:, 2]) @ self.affine[:, :2], np.float32)

    def out_of_upright(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Where points (N, 2) of the image that was turned back are in the image."""
        return np.asarray(points @ self.affine[:, :2].T + self.affine[:, 2], np.float32)

    def turned(self, covariances: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariances (N, 2, 2) of points in the image that was turned back, in the image."""
        R = self.affine[:, :2]
        return np.asarray(R @ covariances @ R.T)
