"""The parts of procedural textures: periodic noise and periodic drawings."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fvslam_graph.core.camera import Image
from fvslam_graph.simulation.worlds.ripmap import Grey, RipMap

Points = NDArray[np.float64]

_SHIFT = 4  # bits of sub-texel precision of drawn polygons


def noise(rng: np.random.Generator, shape: tuple[int, int], *octaves: tuple[int, float]) -> Grey:
    """Periodic noise, (H, W): cubic interpolation through random grids of cell sizes that divide H and W.

    Args:
        rng: Where the grids come from.
        shape: (H, W).
        octaves: (cell size in texels, standard deviation) of each grid, the coarsest first.
    """
    cell = octaves[0][0]
    total = np.zeros((shape[0] // cell, shape[1] // cell), np.float32)
    for finer, sigma in octaves:
        total = _enlarged(total, cell // finer)
        total += np.float32(sigma) * rng.standard_normal(total.shape, np.float32)
        cell = finer
    return _enlarged(total, cell)


class Canvas:
    """One period of a texture to draw on; places are (u, v) in metres, and what crosses a border comes in opposite.

    Args:
        grey: Grey values to begin with, (H, W).
        texel: Size of a texel (along u, along v), metres.
    """

    def __init__(self, grey: Grey, texel: tuple[float, float]) -> None:
        self.grey = grey
        self.texel = np.array(texel)
        self.size = np.array(grey.shape[::-1]) * texel

    def polygons(self, corners: Points, tones: ArrayLike) -> None:
        """Fill convex polygons, (N, K, 2), with grey values, (N,) or one for all."""
        height, width = self.grey.shape
        corners = corners / self.texel
        low, high = corners.min(axis=1), corners.max(axis=1)
        tones = np.broadcast_to(np.asarray(tones, float), len(corners))
        for shift in np.array([(i, j) for i in (-width, 0, width) for j in (-height, 0, height)]):
            inside = np.flatnonzero(np.all((low + shift < (width, height)) & (high + shift >= 0), axis=1))
            for k in inside:
                fixed_point = np.rint((corners[k] + shift) * 2**_SHIFT).astype(np.int32)
                cv2.fillConvexPoly(self.grey, fixed_point, float(tones[k]), cv2.LINE_8, _SHIFT)

    def rectangles(self, centres: Points, sizes: ArrayLike, tones: ArrayLike, angles: ArrayLike = 0.0) -> None:
        """Fill rectangles with centres (N, 2), sizes (N, 2) or (2,), and angles (N,) or one, radians."""
        unit = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        corners = unit * np.broadcast_to(np.asarray(sizes, float), centres.shape)[:, None]
        self.polygons(corners @ _rotations(angles) + centres[:, None], tones)

    def stones(self, rng: np.random.Generator, centres: Points, radii: Points, tones: ArrayLike) -> None:
        """Fill irregular blobs with centres (N, 2) and mean radii (N,)."""
        angles = np.linspace(0, 2 * np.pi, 7, endpoint=False) + rng.uniform(0, 2 * np.pi, (len(centres), 1))
        lengths = radii[:, None] * rng.uniform(0.75, 1.25, angles.shape)
        outline = lengths[..., None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        self.polygons(centres[:, None] + outline, tones)

    def ribbon(self, middle: Points, low: float, high: float, tones: ArrayLike) -> None:
        """Fill the band that runs from `low` to `high` metres to one side of a polyline (N, 2); N - 1 tones or one."""
        direction = np.gradient(middle, axis=0)
        side = direction[:, ::-1] * (1, -1) / np.linalg.norm(direction, axis=1, keepdims=True)
        inner, outer = middle + low * side, middle + high * side
        self.polygons(np.stack([inner[:-1], inner[1:], outer[1:], outer[:-1]], axis=1), tones)

    def finished(self) -> RipMap:
        """The texture, smoothed so that it has no detail finer than about two texels."""
        return RipMap(_smoothed(self.grey), (float(self.texel[0]), float(self.texel[1])))


def _smoothed(grey: Grey) -> Image:
    padded = np.pad(grey, 4, mode="wrap")
    cv2.GaussianBlur(padded, (0, 0), 0.7, dst=padded)
    np.clip(padded, 3, 252, out=padded)
    np.rint(padded, out=padded)
    return padded[4:-4, 4:-4].astype(np.uint8)


def _enlarged(grid: Grey, factor: int) -> Grey:
    if factor == 1:
        return grid
    wrapped = np.pad(grid, 2, mode="wrap")
    size = (wrapped.shape[1] * factor, wrapped.shape[0] * factor)
    inside = slice(2 * factor, -2 * factor)
    large: Grey = cv2.resize(wrapped, size, interpolation=cv2.INTER_CUBIC)[inside, inside]
    return large


def _rotations(angles: ArrayLike) -> Points:
    """Matrices (..., 2, 2) that turn row vectors by the angles."""
    cos, sin = np.cos(angles), np.sin(angles)
    return np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], -2)
