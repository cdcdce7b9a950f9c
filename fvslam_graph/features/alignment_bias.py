"""What a tracker that only shifts patches errs by where patches are deformed, as they are where things come nearer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image
from fvslam_graph.features.texture import gradients_around

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
    offsets = np.arange(window) - window // 2
    across, down = (axis.ravel() for axis in np.meshgrid(offsets, offsets))
    x, y = gradients_around(image, np.rint(points), window)
    # Sums over each patch of what is in common to all pixels, and of what grows with the offset.
    moments = np.stack([np.ones(across.size), across, down], dtype=np.float32)
    xx, xy, yy = ((moments @ (a * b)).astype(float) for a, b in ((x, x), (x, y), (y, y)))
    least = MIN_TEXTURE * (xx[0] + yy[0]) + 1e-9
    a, b, d = xx[0] + least, xy[0], yy[0] + least
    inverse = np.array([[d, -b], [-b, a]]) / (a * d - b * b)
    levers = np.array([[xx[1:], xy[1:]], [xy[1:], yy[1:]]]).reshape(2, 4, -1)
    bias: NDArray[np.float64] = (inverse.transpose(2, 0, 1) @ levers.transpose(2, 0, 1)).reshape(-1, 2, 2, 2)
    return bias
