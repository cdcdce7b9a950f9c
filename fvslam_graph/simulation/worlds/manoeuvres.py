"""Flights leg by leg, as small UAVs are flown: hovering, turning in place, climbing, sideways, in lanes."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from fvslam_graph.core.random_streams import stream
from fvslam_graph.simulation.worlds.motion import KNOT_STEP, Motion, knots, wobble
from fvslam_graph.simulation.worlds.waves import Waves

Manoeuvre = Literal["hover", "turn", "climb", "sideways", "survey"]

_SMOOTHING = 0.6  # seconds that a multirotor takes from one leg to the next (standard deviation of a Gaussian)


@dataclass(frozen=True)
class _Leg:
    """What is flown for some seconds, in the axes of the vehicle: m/s, and rad/s to the left."""

    seconds: float
    forward: float = 0.0
    left: float = 0.0
    climb: float = 0.0
    turn: float = 0.0


_LEGS: dict[Manoeuvre, tuple[_Leg, ...]] = {
    "hover": (_Leg(6), _Leg(6, forward=8), _Leg(6), _Leg(6, forward=-8)),
    "turn": (_Leg(5, forward=8), _Leg(10, turn=np.pi / 5)),
    "climb": (_Leg(8, climb=3), _Leg(6, forward=8), _Leg(8, climb=-3), _Leg(6, forward=8)),
    "sideways": (_Leg(6, left=7), _Leg(6, forward=-6), _Leg(6, left=-7), _Leg(6, forward=6)),
    "survey": (
        _Leg(6, forward=9),
        _Leg(4, forward=2, turn=np.pi / 4),
        _Leg(6, forward=9),
        _Leg(4, forward=2, turn=-np.pi / 4),
    ),
}


def manoeuvre_motion(manoeuvre: Manoeuvre, seed: int, duration: float, altitude: float, depression: float) -> Motion:
    """A multirotor in gusts that flies the legs of a manoeuvre again and again.

    Args:
        manoeuvre: Which.
        seed: Of the gusts.
        duration: Seconds.
        altitude: Metres, at which it is at time 0.
        depression: Radians that its camera looks below the vehicle's forward axis.
    """
    rng = stream(seed, "manoeuvre")
    t = knots(duration)
    legs = np.array([astuple(leg) for leg in _LEGS[manoeuvre]])
    ends = np.cumsum(legs[:, 0])
    flown = legs[np.searchsorted(ends, t.clip(min=0.0) % ends[-1], side="right"), 1:]
    forward, left, climb, turn = gaussian_filter1d(flown, _SMOOTHING / KNOT_STEP, axis=0, mode="nearest").T
    heading = CubicSpline(t, turn).antiderivative()
    gust = np.column_stack([Waves.random(rng, (0.15, 3.1), (0.1, 1.7), (0.3, 8.0))(t, 1) for _ in range(3)])
    path = CubicSpline(t, _in_world(heading(t), forward, left, climb) + gust).antiderivative()
    path.c[-1] += np.array([0.0, 0.0, altitude]) - path(0.0)
    return Motion(path, wobble(rng, (0.004, 0.9), (0.002, 0.37)), depression, leans=True, heading=heading)


def _in_world(
    heading: NDArray[np.float64], forward: NDArray[np.float64], left: NDArray[np.float64], climb: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Velocities (N, 3) in the world."""
    c, s = np.cos(heading), np.sin(heading)
    return np.column_stack([c * forward - s * left, s * forward + c * left, climb])
