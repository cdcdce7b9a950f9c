"""The offset between the clocks of a video and of a drone's record, by the motion that both know.

A camera that looks down sees a change of heading as a turn of the image, climbing as a change of its scale, and speed
over height as flow. The offset is where these rates and those of the record correlate best. Other cameras see less of
it; what does not correlate counts for nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.sensors import SensorKind, SensorSeries, interpolate
from fvslam_graph.sequences.drone_record import MAX_RECORD_GAP
from fvslam_graph.sequences.image_motion import ImageMotion
from fvslam_graph.sequences.oxts import EARTH_RADIUS

Array = NDArray[np.float64]

STEP = 0.1  # seconds between the samples that are compared, and between the offsets that are tried first
FINE = 0.02  # seconds between those about the best one
SMOOTHING = 3.0  # samples, standard deviation of a Gaussian: heights come in steps of 0.1 m, and slopes look like turns
MIN_OVERLAP = 8.0  # seconds that both know
MAX_DURATION = 20_000.0  # seconds of a flight; a record of more has stamps that jump
MIN_HEIGHT = 1.0  # metres above the take-off; below, the drone stands or nearly so
# By how much the logarithm of the likelihood must be above that of any other offset. Measured on generated flights of
# 30 and 60 s: at most 12 in 408 pairs of a video and the record of another flight, at least 47 with its own at 10 Hz.
CLEAR = 15.0
MAX_SIGMA = 0.25  # seconds


class ClockOffset(NamedTuple):
    """What is added to the times of the record to have those of the video, seconds, and its standard deviation."""

    seconds: float
    sigma: float


def estimate_clock_offset(motion: ImageMotion, series: Iterable[SensorSeries]) -> ClockOffset | None:
    """The offset at which the record explains the image motion best; None where none is clearly the best.

    Args:
        motion: Of the video, whose first frame is at zero seconds.
        series: Of the record, on its own clock.
    """
    known = {one.kind: one for one in series}
    start, end = min(one.stamps[0] for one in known.values()), max(one.stamps[-1] for one in known.values())
    if len(motion.stamps) < 2 or end - start > MAX_DURATION:
        return None
    times = np.arange(motion.stamps[0], motion.stamps[-1], STEP)
    seen, recorded = _seen_rates(motion, times), _recorded_rates(known, np.arange(start, end, STEP))
    lags, correlations, independent = _compare([(seen[name], recorded[name]) for name in recorded])
    scores = _likelihood(correlations, independent)
    peaks = np.flatnonzero((scores[1:-1] > scores[:-2]) & (scores[1:-1] >= scores[2:])) + 1
    if not len(peaks):
        return None
    *others, best = peaks[np.argsort(scores[peaks])]
    if not scores[best] - max([scores[0], scores[-1], *scores[others]]) > CLEAR:
        return None

    offsets = lags[best] * STEP + times[0] - start + np.arange(-STEP, STEP + FINE, FINE)
    near = np.empty((len(recorded), len(offsets)))
    for number, offset in enumerate(offsets):
        moved = _recorded_rates(known, times - offset)
        near[:, number] = [_correlation(seen[name], moved[name])[0] for name in moved]
    fine = _likelihood(near, independent[:, best, None])
    peak = int(np.clip(np.argmax(fine), 1, len(fine) - 2))
    below, top, above = fine[peak - 1 : peak + 2]
    bend = 2 * top - below - above
    if not bend > (FINE / MAX_SIGMA) ** 2:
        return None
    return ClockOffset(float(offsets[peak] + FINE * (above - below) / (2 * bend)), float(FINE / np.sqrt(bend)))


def _likelihood(correlations: Array, independent: Array) -> Array:
    """Logarithm of the likelihood, (L,), against rates that are unrelated, by correlations of K rates, (K, L).

    Args:
        correlations: At each of L offsets.
        independent: Of how many samples they are, (K, L) or (K, 1).
    """
    likelihood: Array = (-0.5 * independent * np.log1p(-(correlations**2))).sum(axis=0)
    return likelihood


def _seen_rates(motion: ImageMotion, grid: Array) -> dict[str, Array]:
    rates = {"heading": -motion.turn, "climb": -motion.growth, "speed": motion.flow}
    return {name: _smooth(interpolate(motion.stamps, rate, grid, MAX_RECORD_GAP)) for name, rate in rates.items()}


def _recorded_rates(known: dict[SensorKind, SensorSeries], grid: Array) -> dict[str, Array]:
    """What of the record images show, (len(grid),) each: change of heading, climb and speed over height."""

    def rate(stamps: Array, values: Array) -> Array:
        return _smooth(interpolate(stamps, values, grid, MAX_RECORD_GAP), derivative=1) / STEP

    rates = {}
    if (attitude := known.get(SensorKind.ATTITUDE)) is not None:
        rates["heading"] = rate(attitude.stamps, np.unwrap(attitude.values[:, 0]))
    if (height := known.get(SensorKind.HEIGHT)) is not None:
        metres = np.where(height.values[:, 0] > MIN_HEIGHT, height.values[:, 0], np.nan)
        rates["climb"] = rate(height.stamps, np.log(metres))
        if (place := known.get(SensorKind.GNSS)) is not None:
            latitude, longitude = np.radians(place.values[:, :2]).T
            north = rate(place.stamps, EARTH_RADIUS * latitude)
            east = rate(place.stamps, EARTH_RADIUS * np.cos(latitude[0]) * np.unwrap(longitude))
            rates["speed"] = np.hypot(north, east) / interpolate(height.stamps, metres, grid, MAX_RECORD_GAP)
    return rates


def _smooth(samples: Array, derivative: int = 0) -> Array:
    """Samples (N,), or their derivative by the sample, under a Gaussian; NaN where it reaches over what is known."""
    from scipy.ndimage import gaussian_filter1d

    smooth: Array = gaussian_filter1d(samples, SMOOTHING, order=derivative, mode="constant", cval=np.nan, truncate=3)
    return smooth


def _compare(pairs: list[tuple[Array, Array]]) -> tuple[NDArray[np.int_], Array, Array]:
    """How well what is seen follows the record, at every lag of enough overlap.

    Args:
        pairs: What is seen, (V,), and what is recorded, (R,), of each of K rates; NaN where unknown.

    Returns:
        By how many samples the record is moved, (L,); the correlations, (K, L), none of them negative; and of how
        many independent samples they are, (K, L).
    """
    seen_length, recorded_length = (len(rates) for rates in pairs[0])
    least = int(max(MIN_OVERLAP / STEP, min(seen_length, recorded_length) / 2))
    lags = np.arange(least - recorded_length, seen_length - least + 1)
    compared = np.zeros((2, len(pairs), len(lags)))
    for rate, (seen, recorded) in enumerate(pairs):
        for number, lag in enumerate(lags):
            a = seen[max(lag, 0) : recorded_length + lag]
            b = recorded[max(-lag, 0) : seen_length - lag]
            if (np.isfinite(a) & np.isfinite(b)).sum() >= least:
                compared[:, rate, number] = _correlation(a, b)
    return lags, compared[0], compared[1]


def _correlation(a: Array, b: Array) -> tuple[float, float]:
    """Pearson's correlation of a and b (N,) where both are known, and of how many independent samples.

    It is zero where it would be negative. Residuals that resemble themselves for long count for few: as many as their
    spectrum has frequencies.
    """
    both = np.isfinite(a) & np.isfinite(b)
    a, b = (rates[both] - rates[both].mean() if both.any() else np.zeros(1) for rates in (a, b))
    product, size = a @ b, np.sqrt((a @ a) * (b @ b))
    if not product > 0:
        return 0.0, 0.0
    power = np.abs(np.fft.fft(a - product / (b @ b) * b)) ** 2
    return min(float(product / size), 1 - 1e-9), float(power.sum() ** 2 / max(power @ power, 1e-300))
