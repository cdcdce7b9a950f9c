"""The world of `synthetic:drive`: a street between houses."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from functools import cached_property

import cv2
import gtsam
import numpy as np

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.random_streams import stream
from fvslam_graph.simulation.worlds.panels import FADE, Panel, paint, paint_depth
from fvslam_graph.simulation.worlds.patterns import noise
from fvslam_graph.simulation.worlds.ripmap import Grey, RipMap
from fvslam_graph.simulation.worlds.roadside import Roadside, Solid
from fvslam_graph.simulation.worlds.street_textures import GROUND_WIDTH, street_ground
from fvslam_graph.simulation.worlds.view import fade, length, rays
from fvslam_graph.simulation.worlds.waves import Waves

_SEGMENT = 10.0  # metres of ground that are straight
_BEHIND = 12.0  # metres behind the camera where things can begin that are in view
_AHEAD = FADE[1]  # metres


class Street:
    """A gently curving street along x; y points left, z up, and the ground is z = 0.

    Args:
        camera: Without distortion.
        middle: y of the street's middle as a function of x, metres.
        end: Largest x that is driven, metres; houses and textures are made when the first image is asked for.
        seed: The street's.
    """

    def __init__(self, camera: Camera, middle: Waves, end: float, seed: int) -> None:
        self.camera = camera
        self._middle = middle
        self._end = end
        self._seed = seed

    @cached_property
    def roadside(self) -> Roadside:
        """Makes what stands along the street."""
        return Roadside(self._middle, self._seed)

    @cached_property
    def solids(self) -> list[Solid]:
        """Things along the street, the farthest first."""
        return self.roadside.build(-2 * _BEHIND, self._end + _AHEAD)

    @cached_property
    def _ground(self) -> RipMap:
        return street_ground(stream(self._seed, "ground"))

    @cached_property
    def _clouds(self) -> Grey:
        return noise(stream(self._seed, "clouds"), (256, 256), (64, 12), (32, 8), (16, 4))

    def render(self, pose: gtsam.Pose3, traffic: Sequence[Solid] = ()) -> Grey:
        """The image (H, W), grey values, from world_T_camera, with other vehicles on the road."""
        image = self._backdrop(pose)
        paint(image, self.panels(pose, traffic), self.camera, pose)
        return image

    def depth(self, pose: gtsam.Pose3, traffic: Sequence[Solid] = ()) -> Grey:
        """Distance (H, W) along the optical axis of what each pixel sees, metres; infinite in the sky."""
        depth = np.full((self.camera.height, self.camera.width), np.inf, np.float32)
        paint_depth(depth, self.panels(pose, traffic), self.camera, pose)
        return depth

    def _backdrop(self, pose: gtsam.Pose3) -> Grey:
        """A bare plain up to the horizon, haze, and a sky with soft clouds on a level layer infinitely far away."""
        x, y, z = rays(self.camera, pose.rotation())
        steep = z / length(x, y)
        rise = np.maximum(steep, 0)
        scale = 40 / (rise + np.float32(0.1))  # texels of the layer
        clouds = cv2.remap(self._clouds, x * scale, y * scale, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        plain = fade(np.float32(pose.z()) / np.maximum(-steep, np.float32(1e-4)), 0, FADE[1])
        backdrop: Grey = 222 - 45 * np.minimum(rise, 1) + clouds * np.minimum(6 * rise, 1) - 120 * plain
        return backdrop

    def panels(self, pose: gtsam.Pose3, traffic: Sequence[Solid] = ()) -> list[Panel]:
        """Things that can be in view, the farthest first."""
        x = pose.x()
        first = bisect_left(self.solids, -(x + _AHEAD), key=lambda solid: -solid.order)
        last = bisect_right(self.solids, _BEHIND - x, key=lambda solid: -solid.order)
        solids = sorted([*self.solids[first:last], *traffic], key=lambda solid: -solid.order)
        return [*self._road(x), *(panel for solid in solids for panel in solid.box.panels)]

    def _road(self, x: float) -> list[Panel]:
        """The ground near x in straight segments; on its texture, u is x and v is across."""
        across = np.array([0.0, GROUND_WIDTH, 0.0])
        panels = []
        first = np.floor((x - _BEHIND) / _SEGMENT) * _SEGMENT
        for start in np.arange(first + _AHEAD, first - 1, -_SEGMENT):
            right = np.array([start, self._middle(start) - GROUND_WIDTH / 2, 0.0])
            along = np.array([_SEGMENT, self._middle(start + _SEGMENT) - self._middle(start), 0.0])
            panels.append(Panel(right, along, across, self._ground, (start, 0.0), (_SEGMENT, GROUND_WIDTH)))
        return panels
