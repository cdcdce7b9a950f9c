"""`synthetic:uav`: a small UAV above open country, its camera looking down or ahead and down."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.random_streams import stream
from fvslam_graph.simulation.worlds.boxes import Box
from fvslam_graph.simulation.worlds.manoeuvres import Manoeuvre, manoeuvre_motion
from fvslam_graph.simulation.worlds.motion import Motion, knots, wobble
from fvslam_graph.simulation.worlds.panels import paint
from fvslam_graph.simulation.worlds.ripmap import Grey
from fvslam_graph.simulation.worlds.terrain import Terrain
from fvslam_graph.simulation.worlds.waves import Waves

ALTITUDE = 27.0  # metres above the mean plane, on average
SPEED = 12.8  # m/s, on average
_LANE_WIDTH = 4.5  # metres between the cars below it
View = Literal["downward", "oblique"]
DEPRESSION: dict[View, float] = {
    "downward": np.pi / 2,
    "oblique": np.pi / 4,
}  # of the camera below the vehicle's forward axis


def uav_motion(seed: int, duration: float, depression: float) -> Motion:
    """A multirotor that weaves and climbs for `duration` seconds, its camera `depression` radians below forward."""
    rng = stream(seed, "flight")
    heading = Waves.random(rng, (0.50, 26.0), (0.06, 11.0))  # rad
    speed = Waves.random(rng, (0.6, 15.0), (0.3, 7.0))  # m/s
    climb = Waves.random(rng, (2.0, 17.0), (0.8, 9.0))  # m
    t = knots(duration)
    course, pace = rng.uniform(0, 2 * np.pi) + heading(t), SPEED + speed(t)
    velocity = np.column_stack([pace * np.cos(course), pace * np.sin(course), climb(t, 1)])
    path = CubicSpline(t, velocity).antiderivative()
    path.c[-1] += (0.0, 0.0, ALTITUDE + climb(t[0]))
    return Motion(path, wobble(rng, (0.004, 0.9), (0.002, 0.37)), depression, leans=True)


def uav_camera(size: tuple[int, int]) -> Camera:
    """A camera with 67 degrees across; size is the image's (width, height), pixels."""
    width, height = size
    focal = 0.75 * width
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


class UavWorld:
    """The country, the flight over it, and cars that drive below the UAV.

    Args:
        size: Image (width, height), pixels.
        view: "downward" or "oblique".
        duration: Seconds.
        movers: Number of cars.
        seed: Of everything random.
        manoeuvre: What it flies; None for a flight that weaves and climbs.
    """

    height_source = "synthetic altimeter"

    def __init__(
        self,
        size: tuple[int, int],
        view: View,
        duration: float,
        movers: int,
        seed: int,
        manoeuvre: Manoeuvre | None = None,
    ) -> None:
        self.camera = uav_camera(size)
        if manoeuvre is None:
            self.motion = uav_motion(seed, duration, DEPRESSION[view])
        else:
            self.motion = manoeuvre_motion(manoeuvre, seed, duration, ALTITUDE, DEPRESSION[view])
        self.terrain = Terrain(self.camera, seed)
        self._ahead = ALTITUDE / np.tan(DEPRESSION[view])
        rng = stream(seed, "traffic")
        self._lanes = _LANE_WIDTH * (np.arange(movers) - (movers - 1) / 2)
        self._offsets = [
            (Waves.random(rng, (6.0, 8.0), (3.0, 13.0)), Waves.random(rng, (1.0, 5.0))) for _ in range(movers)
        ]

    def render(self, time: float) -> Grey:
        """The image (H, W), grey values, at `time` in seconds."""
        pose = self.motion.pose(time)
        image = self.terrain.render(pose)
        for number in range(len(self._offsets)):
            paint(image, self._car(number, time).panels, self.camera, pose)
        return image

    def _car(self, number: int, time: float) -> Box:
        place = self._place(number, time)
        course = self._place(number, time + 0.05) - self._place(number, time - 0.05)
        return self.terrain.car(place, course / np.linalg.norm(course), shade=(1.2, 0.6)[number % 2])

    def _place(self, number: int, time: float) -> NDArray[np.float64]:
        """Where a car is, (2,), metres: it wanders about in its lane in the middle of the view."""
        forward, left = self._offsets[number]
        x, y, _ = self.motion.path(time)
        vx, vy, _ = self.motion.path(time, 1)
        ahead = np.array([vx, vy]) / np.hypot(vx, vy)
        sideways = np.array([-ahead[1], ahead[0]])
        place: NDArray[np.float64] = (
            (x, y) + (self._ahead + forward(time)) * ahead + (self._lanes[number] + left(time)) * sideways
        )
        return place
