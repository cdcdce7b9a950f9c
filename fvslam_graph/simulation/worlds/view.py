"""Which way every pixel looks."""

from __future__ import annotations

import gtsam
import numpy as np

from fvslam_graph.core.camera import Camera
from fvslam_graph.simulation.worlds.ripmap import Grey


def rays(camera: Camera, rotation: gtsam.Rot3) -> tuple[Grey, Grey, Grey]:
    """World components x, y, z, each (H, W), of the viewing rays with unit depth; rotation is world_R_camera."""
    columns = ((np.arange(camera.width) - camera.cx) / camera.fx).astype(np.float32)
    rows = ((np.arange(camera.height)[:, None] - camera.cy) / camera.fy).astype(np.float32)
    x, y, z = (
        right * columns + (down * rows + forward) for right, down, forward in rotation.matrix().astype(np.float32)
    )
    return x, y, z


def length(a: Grey, b: Grey) -> Grey:
    """sqrt(a^2 + b^2); several times faster than np.hypot, which guards against overflow."""
    return np.sqrt(a * a + b * b)


def fade(distance: Grey, start: float, end: float) -> Grey:
    """1 up to the distance `start`, falling smoothly to 0 at `end`."""
    x: Grey = np.clip((end - distance) / (end - start), 0, 1)
    return x * x * (3 - 2 * x)
