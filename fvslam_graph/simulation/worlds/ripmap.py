"""Textures that are filtered to the size of a pixel before they are sampled."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image

Grey = NDArray[np.float32]

_PAD = 2  # texels repeated on each side of a level, so that interpolation works across the period
_COARSEST = 8  # texels; halving stops here
_HALVING = np.array([1, 4, 6, 4, 1], np.float32) / 16


class RipMap:
    """A periodic texture without aliasing.

    A pixel sees a patch of the surface; on a road it is much longer than wide. If the texture has detail finer than the
    patch, its images shimmer and corners do not stay where they belong. So the texture is kept halved 0, 1, 2, ...
    times along each axis, independently (a rip-map: the anisotropic form of Williams' mip-map, "Pyramidal
    parametrics", SIGGRAPH 1983), and a sample blends the four versions nearest to the patch's size.

    Args:
        image: One period, (H, W) uint8, H and W powers of two; texel (row, column) lies at v = row * texel_v,
            u = column * texel_u, and the texture has no detail finer than about two texels.
        texel: (texel_u, texel_v), metres.

    Attributes:
        period: (period_u, period_v), metres.
    """

    def __init__(self, image: Image, texel: tuple[float, float]) -> None:
        height, width = image.shape
        self._columns = _Axis(width, texel[0])
        self._rows = _Axis(height, texel[1])
        self.period = (width * texel[0], height * texel[1])
        # All versions in one picture: those halved along u side by side, and below them the same halved along v.
        strip = np.hstack(_pyramid(image, 1, self._columns.levels))
        self._atlas = np.vstack(_pyramid(strip, 0, self._rows.levels))

    def sample(self, u: Grey, v: Grey, du: Grey, dv: Grey) -> Grey:
        """Grey values where the surface coordinates are (u, v) and a pixel spans (du, dv); all (H, W), metres."""
        fine_x, coarse_x, weight_x = self._columns.locate(u, du)
        fine_y, coarse_y, weight_y = self._rows.locate(v, dv)
        fine = _blend(self._at(fine_x, fine_y), self._at(coarse_x, fine_y), weight_x)
        coarse = _blend(self._at(fine_x, coarse_y), self._at(coarse_x, coarse_y), weight_x)
        return _blend(fine, coarse, weight_y)

    def _at(self, x: Grey, y: Grey) -> Grey:
        sampled: Grey = cv2.remap(self._atlas, x, y, cv2.INTER_LINEAR).astype(np.float32)
        return sampled


class _Axis:
    """Where the versions halved 0, 1, 2, ... times lie along one side of the atlas."""

    def __init__(self, size: int, texel: float) -> None:
        self.texel = np.float32(texel)
        self.period = np.float32(size * texel)
        self.levels = int(np.log2(size / _COARSEST)) + 1
        lengths = size / 2 ** np.arange(self.levels) + 2 * _PAD
        self.starts = (np.cumsum(lengths) - lengths + _PAD).astype(np.float32)

    def locate(self, position: Grey, span: Grey) -> tuple[Grey, Grey, Grey]:
        """Atlas coordinates in the finer and the coarser version around `span`, and the weight of the coarser."""
        level = np.clip(np.log2(span / self.texel), 0, self.levels - 1.001)
        whole = np.floor(level)
        fine = whole.astype(np.int32)
        texels = (position - self.period * np.floor(position / self.period)) / self.texel
        scaled = np.ldexp(texels, -fine)
        return scaled + self.starts[fine], scaled / 2 + self.starts[fine + 1], level - whole


def _pyramid(image: Image, axis: int, levels: int) -> list[Image]:
    pad = [(0, 0), (0, 0)]
    pad[axis] = (_PAD, _PAD)
    padded = []
    for _ in range(levels):
        padded.append(np.pad(image, pad, mode="wrap"))
        smoothed = cv2.filter2D(padded[-1], -1, _HALVING.reshape((1, -1) if axis else (-1, 1)))
        image = smoothed[_PAD:-_PAD:2] if axis == 0 else smoothed[:, _PAD:-_PAD:2]
    return padded


def _blend(a: Grey, b: Grey, weight: Grey) -> Grey:
    return a + weight * (b - a)
