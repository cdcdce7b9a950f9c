"""Procedural textures of a street: its ground, house fronts, leaves, cars.

On upright textures v is the height.
"""

from __future__ import annotations

import numpy as np

from fvslam_graph.simulation.worlds.patterns import Canvas, Points, noise
from fvslam_graph.simulation.worlds.ripmap import RipMap
from fvslam_graph.simulation.worlds.waves import Waves

GROUND_WIDTH = 20.48  # metres across the street; its middle is at half of it
KERB = 5.5  # metres from the middle
STYLES = 4  # of house fronts, one above the other on the texture
STYLE_HEIGHT = 12.8  # metres
FLOOR = 3.2  # metres
CAR = (4.2, 1.75, 1.45)  # metres: length, width, height
CAR_ENDS = 3.5  # metres on the texture of a car, above its side view


def street_ground(rng: np.random.Generator) -> RipMap:
    """Worn asphalt with markings, kerbs and pavements; u along the street with a period of 102 m, v across."""
    shape = (2048, 4096)
    canvas = Canvas(92 + noise(rng, shape, (256, 6), (64, 6), (16, 6), (8, 6)), (0.025, 0.01))
    extent, middle = canvas.size[0], canvas.size[1] / 2

    def places(count: int) -> Points:
        return rng.uniform((0, middle - KERB), (extent, middle + KERB), (count, 2))

    canvas.rectangles(places(90), rng.uniform((0.4, 0.3), (4, 1.6), (90, 2)), rng.uniform(62, 128, 90))  # repairs
    canvas.grey += noise(rng, shape, (4, 11), (2, 13))
    radii = 0.02 + 0.02 * rng.pareto(2.0, 3000).clip(0, 8)
    canvas.stones(rng, places(3000), radii, rng.choice([38, 52, 135, 160], 3000))
    for start in places(60):
        along = np.linspace(0, rng.uniform(2, 9), 30)
        across = Waves.random(rng, (0.3, rng.uniform(2, 5)), (0.05, rng.uniform(0.5, 1)))(along)
        canvas.ribbon(start + np.column_stack([along, across]), -0.012, 0.012, 40)  # a crack
    dashes = np.arange(12) * extent / 12
    canvas.rectangles(np.column_stack([dashes, np.full(12, middle)]), (3.0, 0.14), rng.uniform(170, 200, 12))

    slabs = np.arange(128) * extent / 128
    for side in (-1, 1):
        kerb = np.column_stack([slabs, np.full(128, middle + side * (KERB + 0.15))])
        canvas.rectangles(kerb, (extent / 128, 0.36), 60)
        canvas.rectangles(kerb, (extent / 128 - 0.04, 0.26), rng.uniform(160, 185, 128))
        for row in range(7):
            slab = np.column_stack([slabs + 0.4 * (row % 2), np.full(128, middle + side * (KERB + 0.65 + 0.6 * row))])
            canvas.rectangles(slab, (extent / 128, 0.6), 88)
            canvas.rectangles(slab, (extent / 128 - 0.04, 0.57), rng.uniform(118, 160, 128))
    canvas.grey += noise(rng, shape, (8, 3), (4, 5), (2, 6))
    return canvas.finished()


def house_fronts(rng: np.random.Generator) -> RipMap:
    """Fronts of houses in several styles; u along the street with a period of 41 m."""
    shape = (2048, 2048)
    canvas = Canvas(noise(rng, shape, (256, 6), (64, 7), (16, 7), (4, 7), (2, 6)), (0.02, 0.025))
    for style in range(STYLES):
        canvas.grey[style * 512 : (style + 1) * 512] += rng.uniform(100, 165)
        bays = int(rng.integers(12, 18))
        bay = canvas.size[0] / bays
        u, floor = (grid.ravel() for grid in np.meshgrid((np.arange(bays) + 0.5) * bay, np.arange(4)))
        centres = np.column_stack([u, STYLE_HEIGHT * style + FLOOR * floor + 1.75])
        width, height = rng.uniform(0.4, 0.6) * bay, rng.uniform(1.3, 1.8)
        trim = rng.uniform(150, 225)
        canvas.rectangles(np.add(centres, (0, 1.25)), (bay, 0.14), rng.uniform(70, 200))  # a ledge above each floor
        canvas.rectangles(centres, (width + 0.24, height + 0.24), trim)
        canvas.rectangles(centres, (width, height), rng.uniform(28, 80, len(u)))
        canvas.rectangles(
            np.add(centres, (0, 0.3 * height)), (width, 0.4 * height), rng.uniform(40, 150, len(u))
        )  # blinds
        canvas.rectangles(centres, (0.07, height), trim)
        canvas.rectangles(np.subtract(centres, (0, height / 2 + 0.12)), (width + 0.4, 0.1), rng.uniform(60, 215))
    canvas.grey += noise(rng, shape, (8, 2), (4, 3), (2, 4))
    return canvas.finished()


def leaves(rng: np.random.Generator) -> RipMap:
    """Hedges, tree tops and, darker, bark; period 10 m."""
    return Canvas(88 + noise(rng, (1024, 1024), (64, 10), (16, 16), (8, 18), (4, 18), (2, 14)), (0.01, 0.01)).finished()


def car_paint(rng: np.random.Generator) -> RipMap:
    """A car: its side in the lower part, its end from the height CAR_ENDS on; u along the car."""
    canvas = Canvas(150 + noise(rng, (512, 512), (128, 6), (8, 3), (2, 3)), (CAR[0] / 512, 2 * CAR_ENDS / 512))
    length, width, _ = CAR

    def add(u: float, v: float, du: float, dv: float, tone: float) -> None:
        canvas.rectangles(np.array([[u, v]]), (du, dv), tone)

    add(length / 2, 0.16, length, 0.32, 48)  # sills
    add(length / 2, 1.10, 2.6, 0.44, 42)
    for pillar in (1.25, 2.15, 3.0):
        add(pillar, 1.10, 0.09, 0.5, 175)
        add(pillar + 0.25, 0.8, 0.2, 0.04, 70)
    wheels = np.array([[0.8, 0.32], [3.4, 0.32]])
    canvas.stones(rng, wheels, np.full(2, 0.36), 25)
    canvas.stones(rng, wheels, np.full(2, 0.18), 150)

    add(width / 2, CAR_ENDS + 0.14, width, 0.28, 40)
    add(width / 2, CAR_ENDS + 1.10, width - 0.3, 0.42, 45)
    add(width / 2, CAR_ENDS + 0.55, 0.5, 0.12, 215)
    for light in (0.2, width - 0.2):
        add(light, CAR_ENDS + 0.68, 0.3, 0.2, 220)
        add(light, CAR_ENDS + 0.68, 0.14, 0.1, 90)
    return canvas.finished()
