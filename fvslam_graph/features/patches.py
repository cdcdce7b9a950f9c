"""Patches that are found again from another view: warped to it, searched by correlation, aligned to sub-pixels."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Image

Array = NDArray[np.float64]
Patches = NDArray[np.float32]

REACH = 20  # pixels from the middle of a kept tile to its rim: what a warped patch may take from
COARSE = 11  # pixels, odd side of a patch in the image halved
SIDE = 2 * COARSE  # pixels, its side in the image itself; its middle lies between pixels
MARGIN = COARSE + 1  # pixels from the rim of the image within which no patch fits
_OFFSETS = np.arange(SIDE) - (SIDE - 1) / 2
_GRID = np.stack(np.meshgrid(_OFFSETS, _OFFSETS)).reshape(2, -1)
_CORNERS = [0, SIDE - 1, -SIDE, -1]  # of this grid
_ALIGNMENT_ITERATIONS = 5
# Added to what an aligned patch tells of its shift, so that a flat one stays where it is, and of its deformation, which
# is some 0.1 where residuals are 1 % of the contrast.
_LEAST = np.array([1e-4, 1e-4, *[1e-2] * 4], np.float32)


def cut_tiles(image: Image, pixels: Array) -> NDArray[np.uint8]:
    """Tiles (N, T, T) with T = 2 REACH + 1 around the whole pixels nearest to `pixels`, (N, 2)."""
    offset = np.arange(-REACH, REACH + 1)
    column, row = np.rint(pixels).astype(np.intp).T
    rows = np.clip(row[:, None] + offset, 0, image.shape[0] - 1)
    columns = np.clip(column[:, None] + offset, 0, image.shape[1] - 1)
    tiles: NDArray[np.uint8] = image[rows[:, :, None], columns[:, None, :]]
    return tiles


def view_change(anchor_T_camera: Array, points: Array, camera: Camera) -> Array:
    """How offsets in the present image become offsets in the image of the anchor, (N, 2, 2).

    A patch is taken as a plane that faces the anchor.

    Args:
        anchor_T_camera: (N, 4, 4) present camera in that of each patch's image.
        points: (N, 3) middles of the patches in the present camera, metres.
        camera: Undistorted.
    """
    rotation, translation = anchor_T_camera[:, :3, :3], anchor_T_camera[:, :3, 3]
    there = np.einsum("nij,nj->ni", rotation, points) + translation
    # A ray x / z = r of the plane n . X = d in the anchor is seen at R^T (r - t n . r / d) in the camera.
    normal = there / (there**2).sum(axis=1, keepdims=True)  # n / d
    forward = rotation.mT @ (np.eye(3) - translation[:, :, None] * normal[:, None, :])
    seen = points / there[:, 2:]  # of the ray that hits the middle
    focal = np.array([camera.fx, camera.fy])
    J_seen = np.zeros((len(points), 2, 3))
    J_seen[:, 0, 0] = J_seen[:, 1, 1] = 1 / seen[:, 2]
    J_seen[:, :, 2] = -seen[:, :2] / seen[:, 2:] ** 2
    change = focal[:, None] * (J_seen @ forward[:, :, :2]) / focal
    determinant = np.linalg.det(change)
    inverse: Array = np.full_like(change, np.nan)
    sound = np.abs(determinant) > 1e-6
    inverse[sound] = np.linalg.inv(change[sound])
    return inverse


def warp(tiles: NDArray[np.uint8], centres: Array, change: Array) -> tuple[Patches, NDArray[np.bool_]]:
    """Patches (N, SIDE, SIDE) as they look from the present view, and which lie within their tiles, (N,).

    Args:
        tiles: (N, T, T).
        centres: (N, 2) where the points are in the tiles, pixels.
        change: (N, 2, 2) from offsets in the present view to offsets in the tile.
    """
    where = centres.T[:, :, None] + change.swapaxes(0, 1) @ _GRID
    corners = where[:, :, _CORNERS]
    within = np.all((corners >= 0) & (corners <= tiles.shape[1] - 1), axis=(0, 2))
    where[:, ~within] = 0.0
    where[1] += tiles.shape[1] * np.arange(len(tiles))[:, None]
    across, down = where.astype(np.float32)
    atlas = tiles.reshape(-1, tiles.shape[2])
    patches: Patches = cv2.remap(atlas, across, down, cv2.INTER_LINEAR).astype(np.float32)
    return patches.reshape(-1, SIDE, SIDE), within


def search(
    image: Image, patches: Patches, expected: Array, covariances: Array, gate: float, radius: int
) -> tuple[Array, Array]:
    """Where in their ellipses patches correlate best, to the two pixels that are one in the image halved.

    Args:
        image: (H, W) uint8.
        patches: (N, SIDE, SIDE).
        expected: (N, 2) pixels.
        covariances: (N, 2, 2) pixels^2.
        gate: Squared Mahalanobis distance at the rim of the ellipse.
        radius: Pixels that are searched at most along each axis.

    Returns:
        (N, 2) pixels, (N,) correlation there, -1 where the ellipse is not in the image.
    """
    height, width = (side // 2 for side in image.shape)
    halved = cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
    size = (COARSE, COARSE * len(patches))
    templates = cv2.resize(patches.reshape(-1, SIDE), size, interpolation=cv2.INTER_AREA).astype(np.uint8)
    templates = templates.reshape(-1, COARSE, COARSE)
    middle = np.rint((expected - 0.5) / 2).astype(np.intp)
    extent = np.sqrt(gate * np.diagonal(covariances, axis1=1, axis2=2)) / 2
    reach = np.clip(np.ceil(extent), 1, radius // 2).astype(np.intp)
    half = COARSE // 2
    low = np.maximum(middle - reach, half)
    high = np.minimum(middle + reach, (width - 1 - half, height - 1 - half))
    information = 4 * np.linalg.inv(covariances) / gate
    found, correlation = expected.copy(), np.full(len(patches), -1.0)
    inside_image = np.flatnonzero((low <= high).all(axis=1))
    boxes = np.hstack([low, high + 1, middle])[inside_image].tolist()
    ellipses = information.reshape(-1, 4)[inside_image][:, [0, 1, 3]].tolist()
    for n, (left, top, right, bottom, column, row), (a, b, d) in zip(inside_image, boxes, ellipses, strict=True):
        window = halved[top - half : bottom + half, left - half : right + half]
        scores = cv2.matchTemplate(window, templates[n], cv2.TM_CCOEFF_NORMED)
        _, correlation[n], _, (x, y) = cv2.minMaxLoc(scores)
        dx, dy = left + x - column, top + y - row
        if a * dx**2 + 2 * b * dx * dy + d * dy**2 > 1:  # rarely: the best of the box is not in the ellipse
            xx, yy = np.arange(left, right) - column, np.arange(top, bottom)[:, None] - row
            inside = a * xx**2 + 2 * b * xx * yy + d * yy**2 <= 1
            inside |= (np.abs(xx) <= 1) & (np.abs(yy) <= 1)  # these count, however small the ellipse is
            _, correlation[n], _, (x, y) = cv2.minMaxLoc(scores, inside.view(np.uint8))
        found[n] = 2 * (left + x) + 0.5, 2 * (top + y) + 0.5
    return found, correlation


def align(image: Image, patches: Patches, start: Array) -> tuple[Array, Array]:
    """Move patches by fractions of a pixel to where they fit best, whatever their brightness, contrast and deformation.

    Source: Baker, Matthews, "Lucas-Kanade 20 years on", IJCV 56(3), 2004, inverse compositional, translations.

    Args:
        image: (H, W) uint8.
        patches: (N, SIDE, SIDE).
        start: (N, 2) pixels, right to one or two pixels.

    Returns:
        (N, 2) pixels, and (N,) the correlation there.
    """
    if not len(patches):
        return start, np.empty(0)
    template = _normalised(patches)
    gradient = np.stack(np.gradient(template.reshape(patches.shape), axis=(2, 1)), axis=1)
    gradient = gradient.reshape(len(patches), 2, -1)
    # How patches look when they are moved, and when they are deformed, for which the shift is not to be mistaken.
    changes = np.concatenate([gradient, *(gradient * offsets for offsets in _GRID.astype(np.float32))], axis=1)
    # Brightness and contrast may change too, so that what of this looks like it is of no use.
    changes -= changes.mean(axis=2, keepdims=True)
    changes -= (changes @ template[:, :, None]) * template[:, None, :]
    steps = (np.linalg.inv(changes @ changes.mT + np.diag(_LEAST)) @ changes)[:, :2]
    position = start
    for _ in range(_ALIGNMENT_ITERATIONS):
        error = _normalised(_sample(image, position)) - template
        position = position - (steps @ error[:, :, None])[:, :, 0]
    return position, (_normalised(_sample(image, position)) * template).sum(axis=1)


def _sample(image: Image, position: Array) -> Patches:
    """Patches (N, SIDE, SIDE) of the image around positions (N, 2)."""
    x, y = (position[:, :, None] + _OFFSETS).astype(np.float32).swapaxes(0, 1)
    across, down = np.tile(x, SIDE), np.repeat(y, SIDE, axis=1)
    seen: Patches = cv2.remap(image, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return seen.astype(np.float32).reshape(-1, SIDE, SIDE)


def _normalised(patches: Patches) -> NDArray[np.float32]:
    """Patches as rows (N, SIDE^2) of zero mean and unit length."""
    rows: NDArray[np.float32] = patches.reshape(-1, SIDE * SIDE)
    rows = rows - rows.mean(axis=1, keepdims=True)
    length = np.sqrt((rows * rows).sum(axis=1, keepdims=True))
    rows /= np.maximum(length, np.float32(1e-3))
    return rows
