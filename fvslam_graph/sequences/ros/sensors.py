"""Other sensors in a bag: GNSS, range finders, barometers; and the ground below that a range finder tells."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.sensors import SensorKind, SensorSeries
from fvslam_graph.core.sequence import Ground
from fvslam_graph.sequences.ground import UAV_TILT, altimeter_readings, level_ground
from fvslam_graph.sequences.ros.frames import FrameTree
from fvslam_graph.sequences.ros.reader import stamp_of

RANGE_TYPE = "sensor_msgs/msg/Range"
MIN_DOWNWARD = 0.9  # of a beam's direction that points down; 26 degrees

_NO_SIGMA = float("nan")


class Reading(NamedTuple):
    """One message: stamp (ns), values and standard deviations as the series has them."""

    stamp: int
    values: tuple[float, ...]
    sigmas: tuple[float, ...]


class RangeFinder(NamedTuple):
    """Readings of a range finder, and the frame whose x axis is its beam."""

    series: SensorSeries
    frame: str


def _gnss(message: Any) -> Reading | None:
    if message.status.status < 0:  # no fix
        return None
    known = message.position_covariance_type > 0
    east, north, up = np.sqrt(np.maximum(message.position_covariance[[0, 4, 8]], 0)) if known else 3 * [_NO_SIGMA]
    position = (message.latitude, message.longitude, message.altitude)
    return Reading(stamp_of(message), position, (float(north), float(east), float(up)))


def _range(message: Any) -> Reading | None:
    bounded = message.max_range > message.min_range
    if bounded and not message.min_range <= message.range <= message.max_range:  # REP 117: nothing is there
        return None
    return Reading(stamp_of(message), (_decimal(message.range),), (_sigma(getattr(message, "variance", 0.0)),))


def _pressure(message: Any) -> Reading:
    return Reading(stamp_of(message), (message.fluid_pressure,), (_sigma(message.variance),))


def _altitude(message: Any) -> Reading:
    return Reading(stamp_of(message), (_decimal(message.relative),), (_NO_SIGMA,))


def _decimal(number: float) -> float:
    """The shortest decimal that this single-precision number stands for: 0.1, and not 0.10000000149."""
    return float(str(np.float32(number)))


def _sigma(variance: float) -> float:
    return float(np.sqrt(variance)) if variance > 0 else _NO_SIGMA  # zero says that nobody knows


SENSOR_READERS: dict[str, tuple[SensorKind, Callable[[Any], Reading | None]]] = {
    "sensor_msgs/msg/NavSatFix": (SensorKind.GNSS, _gnss),
    RANGE_TYPE: (SensorKind.RANGE, _range),
    "sensor_msgs/msg/FluidPressure": (SensorKind.PRESSURE, _pressure),
    "mavros_msgs/msg/Altitude": (SensorKind.HEIGHT, _altitude),
}


def series_of(kind: SensorKind, topic: str, readings: Sequence[Reading]) -> SensorSeries | None:
    """The finite readings in the order of their stamps, each stamp once; None where there are none."""
    first = {reading.stamp: reading for reading in reversed(readings) if np.isfinite(reading.values).all()}
    if not first:
        return None
    ordered = [first[stamp] for stamp in sorted(first)]
    return SensorSeries(
        kind,
        np.array([reading.stamp for reading in ordered], np.int64) / 1e9,
        np.array([reading.values for reading in ordered], float),
        np.array([reading.sigmas for reading in ordered], float),
        topic,
    )


def ground_below(
    finders: Sequence[RangeFinder], tree: FrameTree, camera: str, stamps: NDArray[np.float64]
) -> tuple[Ground | None, tuple[str, ...]]:
    """The ground by the range finder that looks down, at the stamps of the images (N,), and notes.

    TF tells where it looks; of a single one without TF it is assumed. Where TF also says how the camera sits beside it,
    the height is that of the camera and the normal that of the beam.
    """
    down = [finder for finder in finders if _looks_down(finder, tree)]
    unknown = [finder for finder in finders if tree.carrier(finder.frame) == finder.frame]
    if not down and len(unknown) != 1:
        note = "no TF says which range finder looks down: none tells a height above ground"
        return None, (note,) if unknown else ()
    finder = (down or unknown)[0]
    series = finder.series
    notes = () if down else (f"{series.source} is taken to look down, as no TF says where it looks",)

    camera_T_finder = tree.fixed(camera, finder.frame) if down else None
    ahead = 0.0 if camera_T_finder is None else float(camera_T_finder.inverse().translation()[0])
    heights, step, said = altimeter_readings(series.values[:, 0] - ahead, series.source)
    heights = SensorSeries(series.kind, series.stamps, heights[:, None], series.sigmas, series.source).interpolate(
        stamps
    )
    if not np.isfinite(heights).any():
        return None, notes + said
    ground = level_ground(heights[:, 0], UAV_TILT, f"{series.source}, looking down")
    normal = ground.normal if camera_T_finder is None else camera_T_finder.rotation().matrix()[:, 0]
    return Ground(ground.heights, normal, ground.normal_sigma, ground.source, step), notes + said


def _looks_down(finder: RangeFinder, tree: FrameTree) -> bool:
    """Whether TF says so: on a vehicle, z points up (REP 103)."""
    carrier = tree.carrier(finder.frame)
    carrier_T_finder = tree.fixed(carrier, finder.frame) if carrier != finder.frame else None
    return carrier_T_finder is not None and bool(carrier_T_finder.rotation().matrix()[2, 0] < -MIN_DOWNWARD)
