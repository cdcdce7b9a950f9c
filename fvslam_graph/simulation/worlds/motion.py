"""Smooth camera motion above level ground."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from fvslam_graph.core.sequence import Ground
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.simulation.worlds.waves import Waves

RATE = 10.0  # Hz, of the images
GRAVITY = np.array([0.0, 0.0, -9.81])

_PATH_MARGIN = 1.0  # seconds known before the first and after the last frame, for exposures that reach over
KNOT_STEP = 0.05  # seconds between the knots of a path


@dataclass(frozen=True)
class Motion:
    """A camera's path above the ground plane z = 0 and the attitude that goes with it.

    Attributes:
        path: Time (s) to position (3,), metres, with x and y level and z up; twice continuously differentiable.
        wobble: Time (s) to a small rotation vector (3,) in the camera frame, radians.
        depression: Angle of the optical axis below the vehicle's nose, radians.
        leans: The vehicle is a multirotor: it tilts until its thrust gives the path's acceleration.
        heading: Time (s) to where its nose points, radians from x to y; None where that is the direction of travel.
    """

    path: PPoly
    wobble: Callable[[float], NDArray[np.float64]]
    depression: float
    leans: bool
    heading: Callable[[float], float] | None = None

    def pose(self, time: float) -> gtsam.Pose3:
        """world_T_camera at `time`; camera axes x right, y down, z forward."""
        up = self.path(time, 2) - GRAVITY if self.leans else -GRAVITY
        up = up / np.linalg.norm(up)
        if self.heading is None:
            course = self.path(time, 1) * (1, 1, 0)
        else:
            course = np.array([np.cos(self.heading(time)), np.sin(self.heading(time)), 0.0])
        right = np.cross(course, up)
        right /= np.linalg.norm(right)
        axis = np.cos(self.depression) * np.cross(up, right) - np.sin(self.depression) * up
        world_R_camera = gtsam.Rot3(np.column_stack([right, np.cross(axis, right), axis]))
        return gtsam.Pose3(world_R_camera * gtsam.Rot3.Expmap(self.wobble(time)), self.path(time))

    def trajectory(self, stamps: NDArray[np.float64]) -> Trajectory:
        """The poses at the stamps, (N,) seconds, in the frame of the ground plane."""
        return Trajectory(stamps, tuple(self.pose(stamp) for stamp in stamps))

    def ground(self, stamps: NDArray[np.float64], source: str) -> Ground:
        """The plane z = 0 as the camera knows it; `normal_sigma` is the root mean square of its true tilt."""
        matrices = self.trajectory(stamps).matrices
        nominal = np.array([0.0, np.cos(self.depression), np.sin(self.depression)])
        down = -matrices[:, 2, :3]
        tilts = np.arctan2(np.linalg.norm(np.cross(down, nominal), axis=1), down @ nominal)
        return Ground(matrices[:, 2, 3], nominal, float(np.sqrt(np.mean(tilts**2))), source)


def knots(duration: float) -> NDArray[np.float64]:
    """Times, seconds, at which to lay down a path of this duration."""
    return np.arange(-_PATH_MARGIN, duration + _PATH_MARGIN + KNOT_STEP, KNOT_STEP)


def wobble(rng: np.random.Generator, *parts: tuple[float, float]) -> Callable[[float], NDArray[np.float64]]:
    """Shaking about each axis with the given (amplitude in radians, period in seconds)."""
    axes = [Waves.random(rng, *parts) for _ in range(3)]
    return lambda time: np.array([axis(time) for axis in axes])
