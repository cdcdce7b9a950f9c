"""What a tracker that only shifts patches errs by where patches are deformed, as they are where things come nearer."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image

MIN_TEXTURE = 1e-3  # of the texture across an edge, added to that along it, where there is hardly any


def alignment_bias(image: Image, points: NDArray[np.float32], window: int) -> NDArray[np.float64]:
    """How far off the middle of a patch least squares (Lucas and Kanade) has it, by how the patch is deformed.

    A pixel at an offset d from the middle goes to (I + A) d. Where only a shift is sought, each pixel votes for its own
    along its gradient g, so that the shift errs by b = (sum g g^T)^-1 sum g g^T A d: the same again in every image, for
    as long as the patch looks alike.

    Args:
        image: That the patches are taken from, (H, W) uint8.
        points: (N, 2) their middles, pixels.
        window: Pixels, side of a patch.

    Returns:
        (N, 2, 2, 2) by which b_i = sum_jk bias_ijk A_jk, pixels.
    """
    height, width = image.shape
    reach = window // 2
    offsets = np.arange(-reach, reach + 1)
    across, down = (axis.ravel() for axis in np.meshgrid(offsets, offsets))
    column, row = np.rint(points).astype(np.intp).T
    middles = row.clip(reach, height - 1 - reach) * width + column.clip(reach, width - 1 - reach)
    pixels = middles[:, None] + (down * width + across)
    x, y = (gradient.ravel()[pixels].astype(np.float32) for gradient in cv2.spatialGradient(image))
    # Sums over each patch of what is in common to all pixels, and of what grows with the offset.
    moments = np.stack([np.ones(across.size), across, down], axis=1, dtype=np.float32)
    xx, xy, yy = ((a * b) @ moments for a, b in ((x, x), (x, y), (y, y)))
    sums = np.array([[xx, xy], [xy, yy]], float).transpose(2, 0, 1, 3)
    texture, levers = sums[..., 0], sums[..., 1:]
    least = MIN_TEXTURE * np.trace(texture, axis1=1, axis2=2) + 1e-9
    texture = texture + least[:, None, None] * np.eye(2)
    bias: NDArray[np.float64] = np.linalg.solve(texture, levers.reshape(-1, 2, 4)).reshape(-1, 2, 2, 2)
    return bias
