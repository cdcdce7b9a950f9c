"""The procedural texture of open country."""

from __future__ import annotations

import numpy as np

from fvslam_graph.simulation.worlds.patterns import Canvas, noise
from fvslam_graph.simulation.worlds.ripmap import Grey, RipMap
from fvslam_graph.simulation.worlds.waves import Waves


def country(rng: np.random.Generator) -> RipMap:
    """Grass and bare soil, thickets, tracks, stones and sheds as seen from above; 5 cm fine, period 205 m."""
    canvas = Canvas(_plants(rng, (4096, 4096)), (0.05, 0.05))
    extent = canvas.size[0]

    for flip in (1, -1):  # two tracks, along u and along v
        along = np.linspace(0, extent, 201)
        across = rng.uniform(0, extent) + Waves.random(rng, (8, extent), (3, extent / 3))(along)
        middle = np.column_stack([along, across])[:, ::flip]
        for low, high, tone in ((-1.6, 1.6, 150), (-1.0, -0.6, 120), (0.6, 1.0, 125)):
            canvas.ribbon(middle, low, high, tone + rng.normal(0, 4, 200))

    count = 5000
    radii = 0.15 + 0.12 * rng.pareto(2.2, count).clip(0.3, 8)
    tones = rng.choice([55, 75, 160, 185, 205], count) + rng.normal(0, 10, count)
    canvas.stones(rng, rng.uniform(0, extent, (count, 2)), radii, tones)

    count = 60
    centres, angles = rng.uniform(0, extent, (count, 2)), rng.uniform(0, np.pi, count)
    sizes = rng.uniform((3, 2.5), (9, 5), (count, 2))
    ridges = centres + 0.25 * sizes[:, 1:] * np.column_stack([-np.sin(angles), np.cos(angles)])
    canvas.rectangles(centres + 0.5, sizes, 40, angles)  # shadows
    canvas.rectangles(centres, sizes, rng.uniform(90, 210, count), angles)
    canvas.rectangles(ridges, sizes * (1, 0.5), rng.uniform(70, 180, count), angles)
    return canvas.finished()


def _plants(rng: np.random.Generator, shape: tuple[int, int]) -> Grey:
    grey = noise(rng, shape, (256, 9), (64, 7), (16, 6), (8, 5), (4, 9), (2, 8))
    grey += 116
    cover = noise(rng, shape, (256, 1.0), (64, 0.7), (16, 0.5), (8, 0.3))
    grey[cover < -1.3] += 36  # bare soil
    thicket = cover > 1.3
    grey[thicket] = 78 + 1.5 * (grey[thicket] - 116)
    return grey
