"""Things that stand and drive along a street: houses, parked cars, hedges, trees, traffic."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fvslam_graph.core.random_streams import stream
from fvslam_graph.simulation.worlds import street_textures as textures
from fvslam_graph.simulation.worlds.boxes import Box
from fvslam_graph.simulation.worlds.panels import Vector
from fvslam_graph.simulation.worlds.waves import Waves

BoxSize = tuple[float, float, float]  # length, width, height in metres

_SLOT = 8.0  # metres along the street for one parked car and one hedge or tree
_PARKED, _PLANTED = 4.55, 6.7  # metres from the middle of the street to those of parked cars and plants
_HOUSE_DEPTH = 9.0  # metres


class Solid(NamedTuple):
    """A box and its place in the order of painting: of two, the one with the smaller `order` may hide the other.

    A house counts by its far end, what stands in a slot in front of it by the near end of the slot, and a vehicle on
    the road comes after the slot that it has reached. In one slot, plants are behind cars.
    """

    order: float
    box: Box


class Roadside:
    """Builds boxes beside the line y = middle(x) or on it; x, y and lateral (positive to the left) in metres."""

    def __init__(self, middle: Waves, seed: int) -> None:
        self._middle = middle
        self._seed = seed
        self._fronts = textures.house_fronts(stream(seed, "fronts"))
        self._leaves = textures.leaves(stream(seed, "leaves"))
        self._paint = textures.car_paint(stream(seed, "paint"))

    def build(self, start: float, end: float) -> list[Solid]:
        """Both sides of the street from x = start to x = end, the farthest first."""
        solids: list[Solid] = []
        for side in (-1, 1):
            solids += self._houses(stream(self._seed, "houses", side + 1), start, end, side)
            slots = stream(self._seed, "slots", side + 1)
            for slot in np.arange(start, end, _SLOT):
                solids += self._slot(slots, slot, side)
        return sorted(solids, key=lambda solid: -solid.order)

    def vehicle(self, x: float, lateral: float, shade: float) -> Solid:
        """A car on the road with its rear at x and its middle `lateral` to the left."""
        return Solid(x - _SLOT, self._car(x, lateral, shade))

    def _houses(self, rng: np.random.Generator, start: float, end: float, side: int) -> Iterator[Solid]:
        x = start
        while x < end:
            length, height = rng.uniform(9, 18), textures.FLOOR * rng.integers(2, 5) - 0.2
            footprint = self._footprint(x, side * (rng.uniform(8.2, 9.5) + _HOUSE_DEPTH / 2), length, _HOUSE_DEPTH)
            front = (rng.uniform(0, 41), textures.STYLE_HEIGHT * rng.integers(textures.STYLES))
            yield Solid(x + length, Box(*footprint, height, self._fronts, front, front, rng.uniform(0.8, 1.05)))
            x += length + (rng.uniform(2, 6) if rng.random() < 0.3 else 0)

    def _slot(self, rng: np.random.Generator, x: float, side: int) -> Iterator[Solid]:
        kind, lateral, shift = rng.random(), side * _PLANTED, rng.uniform(0, 1)
        if kind < 0.3:
            hedge = (rng.uniform(3, 6.5), 0.8, rng.uniform(0.8, 1.6))
            yield Solid(x, self._plant(x + shift, lateral, hedge))
        elif kind < 0.6:
            tree, crown = x + 1 + 5 * shift, (2.0, 2.0, rng.uniform(2, 3))
            yield Solid(x, self._plant(tree, lateral, (0.25, 0.25, 2.6), shade=0.6))
            yield Solid(x, self._plant(tree - 0.9, lateral, crown, bottom=2.4))
        if rng.random() < 0.45:
            yield Solid(x, self._car(x + rng.uniform(0, 3), side * _PARKED, rng.uniform(0.5, 1.2)))

    def _plant(self, x: float, lateral: float, size: BoxSize, bottom: float = 0.0, shade: float = 1.0) -> Box:
        length, width, height = size
        corner, along, across = self._footprint(x, lateral, length, width)
        corner[2] = bottom
        anchor = (x, lateral)  # so that no two look the same
        return Box(corner, along, across, height, self._leaves, anchor, anchor, shade)

    def _car(self, x: float, lateral: float, shade: float) -> Box:
        length, width, height = textures.CAR
        footprint = self._footprint(x, lateral, length, width)
        return Box(*footprint, height, self._paint, ends=(0.0, textures.CAR_ENDS), shade=shade)

    def _footprint(self, x: float, lateral: float, length: float, width: float) -> tuple[Vector, Vector, Vector]:
        """The rear right corner and the edges forward and to the left of what stands at x, `lateral` off the middle."""
        y = self._middle(x)
        corner = np.array([x, y + lateral - width / 2, 0.0])
        return corner, np.array([length, self._middle(x + length) - y, 0.0]), np.array([0.0, width, 0.0])
