"""Flat textured panels, painted in perspective."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.simulation.worlds.ripmap import Grey, RipMap
from fvslam_graph.simulation.worlds.view import fade, length

Vector = NDArray[np.float64]
Window = tuple[slice, slice]

NEAR = 0.3  # metres; nothing nearer is drawn
FADE = (110.0, 150.0)  # metres over which a panel fades into what is behind it


@dataclass(frozen=True, eq=False)
class Panel:
    """A textured parallelogram that is seen from one side.

    Attributes:
        origin: A corner, (3,), world, metres.
        edge_u, edge_v: The two edges from there, (3,), metres; their cross product points to the side it is seen from.
        texture: What is painted on it.
        anchor: Texture coordinates (u, v) of the corner, metres.
        size: What the edges span of the texture, metres.
        shade: Factor on the texture's grey values.
    """

    origin: Vector
    edge_u: Vector
    edge_v: Vector
    texture: RipMap
    anchor: tuple[float, float]
    size: tuple[float, float]
    shade: float = 1.0


@dataclass(frozen=True)
class _Patch:
    """The part of an image that shows a panel; arrays are (h, w).

    Attributes:
        window: Its rows and columns.
        cover: How much of each pixel the panel covers, 0 to 1.
        depth: Metres.
        u, v, du, dv: Place on the panel, from its corner, and what a pixel spans there, metres of the texture.
    """

    window: Window
    cover: Grey
    depth: Grey
    u: Grey
    v: Grey
    du: Grey
    dv: Grey


def paint(image: Grey, panels: Sequence[Panel], camera: Camera, pose: gtsam.Pose3) -> None:
    """Paint panels, the farthest first, over an image (H, W), from world_T_camera."""
    for panel, patch in _project(panels, camera, pose):
        u0, v0 = np.mod(panel.anchor, panel.texture.period).astype(np.float32)
        part = image[patch.window]
        part += patch.cover * (
            np.float32(panel.shade) * panel.texture.sample(patch.u + u0, patch.v + v0, patch.du, patch.dv) - part
        )


def paint_depth(depth: Grey, panels: Sequence[Panel], camera: Camera, pose: gtsam.Pose3) -> None:
    """Put the depths of panels, the farthest first, over a depth map (H, W), metres, from world_T_camera."""
    for _, patch in _project(panels, camera, pose):
        np.copyto(depth[patch.window], patch.depth, where=patch.cover > 0.5)


def _project(panels: Sequence[Panel], camera: Camera, pose: gtsam.Pose3) -> Iterator[tuple[Panel, _Patch]]:
    """The panels that are seen, in the same order, and where."""
    offsets = np.array([panel.origin for panel in panels]) - pose.translation()
    edges_u, edges_v = np.array([panel.edge_u for panel in panels]), np.array([panel.edge_v for panel in panels])
    facing = np.einsum("ni,ni->n", np.cross(edges_u, edges_v), offsets) < 0
    sizes = np.array([panel.size for panel in panels])
    # Camera coordinates of a place on a panel are plane @ (u, v, 1).
    world_planes = np.stack([edges_u / sizes[:, :1], edges_v / sizes[:, 1:], offsets], axis=-1)
    planes = pose.rotation().matrix().T @ world_planes
    lows, highs = _bounds(planes, sizes, camera)
    for k in np.flatnonzero(facing & np.all(lows < highs, axis=1)).tolist():
        (left, top), (right, bottom) = lows[k], highs[k]
        window = slice(top, bottom), slice(left, right)
        yield panels[k], _patch(window, np.linalg.inv(camera.K @ planes[k]), panels[k].size)


def _patch(window: Window, homography: Vector, size: tuple[float, float]) -> _Patch:
    """A panel in a part of the image; the homography takes a pixel (x, y, 1) to (u, v, 1) / depth."""
    (a, b, c), (d, e, f), (g, h, i) = homography.astype(np.float32)
    y, x = (np.arange(side.start, side.stop, dtype=np.float32) for side in window)
    y = y[:, None]
    nearness = g * x + (h * y + i)
    depth = 1 / np.maximum(nearness, np.float32(1e-4))
    u = (a * x + (b * y + c)) * depth
    v = (d * x + (e * y + f)) * depth
    du = length(a - u * g, b - u * h) * depth
    dv = length(d - v * g, e - v * h) * depth
    cover = _cover(u, du, size[0]) * _cover(v, dv, size[1]) * fade(depth, *FADE) * (nearness > 1e-4)
    return _Patch(window, cover, depth, u, v, du, dv)


def _cover(position: Grey, span: Grey, size: float) -> Grey:
    """1 between 0 and `size`, falling to 0 over one pixel outside, so that neighbouring panels leave no gap."""
    cover: Grey = np.clip(np.minimum(position, size - position) / span + 1, 0, 1)
    return cover


def _bounds(planes: Vector, sizes: Vector, camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first column and row (N, 2), and those after the last, that the panels can touch; empty if they touch none.

    Only what lies farther than NEAR counts: corners, and where an edge crosses that distance.
    """
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    places = np.concatenate([unit * sizes[:, None], np.ones((len(sizes), 4, 1))], axis=-1)
    corners = places @ planes.transpose(0, 2, 1)
    following = np.roll(corners, -1, axis=1)
    ahead = corners[..., 2] > NEAR
    crossing = ahead != np.roll(ahead, -1, axis=1)
    step = np.where(crossing, NEAR - corners[..., 2], 0) / np.where(crossing, following[..., 2] - corners[..., 2], 1)
    outline = np.concatenate([corners, corners + step[..., None] * (following - corners)], axis=1)
    seen = np.concatenate([ahead, crossing], axis=1)
    pixels = camera.project(outline.reshape(-1, 3)).reshape(*seen.shape, 2)
    low = np.where(seen[..., None], pixels, np.inf).min(axis=1)
    high = np.where(seen[..., None], pixels, -np.inf).max(axis=1)
    shape = (camera.width, camera.height)
    return np.clip(np.floor(low) - 1, 0, shape).astype(int), np.clip(np.ceil(high) + 2, 0, shape).astype(int)
