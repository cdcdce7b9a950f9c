"""Fixes of a receiver as simulated from known positions: noise, outliers, a gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.geodesy import LocalFrame
from fvslam_graph.core.sensors import SensorKind, SensorSeries
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Trajectory

Array = NDArray[np.float64]

MAX_RATE = 1000.0  # Hz
OUTLIER = 50.0  # metres, in any direction
PLACE = np.array([49.0, 8.4, 115.0])  # Karlsruhe, where no recording says where it was
ENU_R_CAMERA = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # a level camera that looks north


@dataclass(frozen=True)
class SimulatedReceiver:
    """How a receiver is to be.

    Attributes:
        rate: Fixes per second.
        sigma: Standard deviation along each axis, metres.
        outliers: Share of fixes that are off by `OUTLIER`.
        gap: Seconds in the middle without any fix.
    """

    rate: float
    sigma: float
    outliers: float = 0.0
    gap: float = 0.0

    @classmethod
    def parse(cls, text: str) -> SimulatedReceiver:
        """Read RATE:SIGMA[:OUTLIERS[:GAP]].

        Raises:
            SequenceError: It is not that.
        """
        try:
            receiver = cls(*map(float, text.split(":")))
        except (TypeError, ValueError):
            receiver = cls(0, 0)
        usual = 0 < receiver.rate <= MAX_RATE and 0 < receiver.sigma < np.inf
        if not (usual and 0 <= receiver.outliers < 1 and receiver.gap >= 0):
            raise SequenceError(f"a simulated receiver is RATE_HZ:SIGMA_M[:OUTLIERS[:GAP_S]], not '{text}'")
        return receiver

    def fixes(self, sequence: Sequence, seed: int = 0) -> SensorSeries:
        """What it would have measured along a recording: at the positions of its OXTS packets, or its ground truth.

        Raises:
            SequenceError: The recording has neither.
        """
        known = next((series for series in sequence.sensors if series.kind is SensorKind.GNSS), None)
        if known is not None:
            return self.measure(known.stamps, known.values, f"simulated GNSS from {known.source}", seed)
        if sequence.ground_truth is None:
            raise SequenceError(f"{sequence.name} has no positions from which GNSS could be simulated")
        places = LocalFrame(PLACE).geodetic(true_enu(sequence.ground_truth))
        return self.measure(sequence.ground_truth.stamps, places, "simulated GNSS from ground truth", seed)

    def measure(self, stamps: Array, places: Array, source: str, seed: int) -> SensorSeries:
        """Fixes of places (N, 3), latitude, longitude (degrees) and altitude (m), at their times (N,), seconds."""
        rng = np.random.default_rng([seed, 5])
        ticks = np.arange(stamps[0], stamps[-1], 1 / self.rate)
        chosen = np.unique(np.searchsorted(stamps, ticks - 1e-6))
        chosen = chosen[np.abs(stamps[chosen] - stamps[[0, -1]].mean()) >= self.gap / 2]
        frame = LocalFrame(places[0])
        enu = frame.enu(places[chosen]) + self.sigma * rng.standard_normal((len(chosen), 3))
        wrong = rng.permutation(len(chosen))[: round(self.outliers * len(chosen))]
        away = rng.standard_normal((len(wrong), 3))
        enu[wrong] += OUTLIER * away / np.linalg.norm(away, axis=1, keepdims=True)
        sigmas = np.full((len(chosen), 3), self.sigma)
        return SensorSeries(SensorKind.GNSS, stamps[chosen], frame.geodetic(enu), sigmas, source)


def true_enu(truth: Trajectory) -> Array:
    """Positions (N, 3) of a trajectory, east, north, up at `PLACE`, if its first camera is level and looks north."""
    enu: Array = truth.positions @ ENU_R_CAMERA.T
    return enu
