"""Images turned back to how the keyframe was held: patches that are only shifted get lost where a camera rolls."""

from __future__ import annotations

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image

MIN_TURN = 0.05  # rad, by which the rim of a patch goes half a pixel; what less of it makes tracks err is known


def expected_turn(keyframe: NDArray[np.float32], expected: NDArray[np.float32]) -> gtsam.Pose2 | None:
    """How an image is turned and shifted in its plane against the keyframe; None if it is hardly turned.

    Args:
        keyframe: (N, 2) pixels of points there.
        expected: (N, 2) pixels where they are expected in the image.

    Returns:
        image_T_upright, pixels: from the image that is turned back to the image, nearest to these points.
    """
    nearest = gtsam.Pose2.Align(expected.T.astype(float), keyframe.T.astype(float))
    return nearest if nearest is not None and abs(nearest.theta()) > MIN_TURN else None


def turned_back(image: Image, image_T_upright: gtsam.Pose2) -> Image:
    """The image (H, W) as it would be if the camera had not rolled."""
    height, width = image.shape
    affine, flags = image_T_upright.matrix()[:2], cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(image, affine, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE))
