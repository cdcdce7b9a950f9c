"""`synthetic:drive`: a car's forward camera in a street, like the KITTI recordings."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.random_streams import stream
from fvslam_graph.simulation.worlds.motion import Motion, knots, wobble
from fvslam_graph.simulation.worlds.ripmap import Grey
from fvslam_graph.simulation.worlds.roadside import Solid
from fvslam_graph.simulation.worlds.street import Street
from fvslam_graph.simulation.worlds.waves import Waves

CAMERA_HEIGHT = 1.65  # metres above the road, as on KITTI's car
LANE_OFFSET = 1.75  # metres from the middle of the street to that of a lane
SPEED = 10.0  # m/s, on average
_CYCLE, _PASSED = 100.0, 10.0  # metres: an oncoming car that is 10 m behind the camera begins anew 100 m farther on
KITTI = Camera(1242, 375, 721.5377, 721.5377, 609.5593, 172.854)


def drive_middle(seed: int) -> Waves:
    """The middle of the street, y as a function of x, metres."""
    return Waves.random(stream(seed, "street"), (5.0, 160.0), (0.8, 75.0))


def drive_motion(seed: int, duration: float) -> Motion:
    """A car that follows the right lane of the street for `duration` seconds."""
    rng = stream(seed, "drive")
    advance = Waves.random(rng, (2.5, 11.0), (0.4, 4.0))  # m
    weave = Waves.random(rng, (0.15, 60.0))  # m over m
    t = knots(duration)
    x = SPEED * t + advance(t)
    position = np.column_stack([x, drive_middle(seed)(x) - LANE_OFFSET + weave(x), np.full_like(x, CAMERA_HEIGHT)])
    return Motion(CubicSpline(t, position), wobble(rng, (0.009, 1.4), (0.004, 0.61)), depression=0.0, leans=False)


class DriveWorld:
    """The street, the drive along it, and other cars that drive there.

    Args:
        size: Image (width, height), pixels; KITTI's camera, with the same field of view across.
        duration: Seconds.
        movers: Number of other cars; the first drives ahead, the next comes towards the camera, and so on.
        seed: Of everything random.
    """

    height_source = "camera mounted at a fixed height"

    def __init__(self, size: tuple[int, int], duration: float, movers: int, seed: int) -> None:
        scaled = KITTI.scaled(size[0] / KITTI.width)
        horizon = (KITTI.cy + 0.5) / KITTI.height * size[1] - 0.5
        self.camera = Camera(*size, scaled.fx, scaled.fy, scaled.cx, horizon)
        self.motion = drive_motion(seed, duration)
        self.street = Street(self.camera, drive_middle(seed), float(self.motion.path(duration)[0]), seed)
        rng = stream(seed, "traffic")
        self._gaps = [Waves.random(rng, (3.0, 7.0)) for _ in range(movers)]
        self._starts = rng.uniform(0, _CYCLE) + _CYCLE * np.arange(movers) / max(movers, 1)

    def render(self, time: float) -> Grey:
        """The image (H, W), grey values, at `time` in seconds."""
        return self.street.render(self.motion.pose(time), self.traffic(time))

    def traffic(self, time: float) -> list[Solid]:
        """The other cars at `time` in seconds."""
        return [self._car(number, time) for number in range(len(self._gaps))]

    def _car(self, number: int, time: float) -> Solid:
        x = float(self.motion.path(time)[0])
        if number % 2 == 0:
            gap = 12.0 + 12.0 * (number // 2) + float(self._gaps[number](time))
            return self.street.roadside.vehicle(x + gap, -LANE_OFFSET, shade=0.9)
        gap = (self._starts[number] - SPEED * time - x) % _CYCLE - _PASSED
        return self.street.roadside.vehicle(x + gap, LANE_OFFSET, shade=0.6)
