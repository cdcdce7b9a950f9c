"""Upright boxes made of panels: houses, hedges, vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fvslam_graph.simulation.worlds.panels import Panel, Vector
from fvslam_graph.simulation.worlds.ripmap import RipMap

Anchor = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Box:
    """An upright block.

    Attributes:
        corner: The lowest corner, rear right, (3,), world, metres; z is up.
        along, across: Level edges from there, forward and to the left, (3,), metres.
        height: Metres.
        texture: Of all faces.
        sides, ends: Where on the texture the sides (and the top) and the ends begin, (u, v) metres.
        shade: Factor on the texture's grey values; each face is also lit differently.
    """

    corner: Vector
    along: Vector
    across: Vector
    height: float
    texture: RipMap
    sides: Anchor = (0.0, 0.0)
    ends: Anchor = (0.0, 0.0)
    shade: float = 1.0

    @cached_property
    def panels(self) -> tuple[Panel, ...]:
        """Both sides, both ends and the top, seen from outside."""
        up = np.array([0.0, 0.0, self.height])
        o, a, c = self.corner, self.along, self.across
        length, width = float(np.linalg.norm(a)), float(np.linalg.norm(c))
        side, end = (length, self.height), (width, self.height)
        top = (self.sides[0], self.sides[1] + self.height)
        return (
            Panel(o, a, up, self.texture, self.sides, side, 0.85 * self.shade),
            Panel(o + a + c, -a, up, self.texture, self.sides, side, 1.1 * self.shade),
            Panel(o + c, -c, up, self.texture, self.ends, end, 0.95 * self.shade),
            Panel(o + a, c, up, self.texture, self.ends, end, 0.75 * self.shade),
            Panel(o + up, a, c, self.texture, top, (length, width), 1.2 * self.shade),
        )

    def clearance(self, point: Vector) -> float:
        """Metres by which a point, (3,), lies outside of the box; negative inside."""
        axes = np.column_stack([self.along, self.across, (0.0, 0.0, self.height)])
        place = np.linalg.solve(axes, point - self.corner)
        return float((np.maximum(-place, place - 1) * np.linalg.norm(axes, axis=0)).max())
