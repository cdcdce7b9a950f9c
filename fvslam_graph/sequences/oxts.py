"""GPS/IMU packets of KITTI's OXTS RT 3003: where the unit was and how it was turned."""

from __future__ import annotations

import re
from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import SequenceError, TrajectoryError
from fvslam_graph.core.text_files import read_text

_TIME = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d(\.\d{1,9})?")

EARTH_RADIUS = 6378137.0  # metres, WGS 84 equator, as in KITTI's development kit


def mercator(latitude: NDArray[np.float64], longitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """East and north, (N, 2) metres, of latitudes and longitudes (N,) in degrees.

    Mercator projection with the scale of the first latitude (Geiger et al., "Vision meets Robotics", IJRR 2013).
    """
    scale = np.cos(np.radians(latitude[0])) * EARTH_RADIUS
    east = scale * np.radians(longitude)
    north = scale * np.log(np.tan(np.radians(90 + latitude) / 2))
    return np.column_stack([east, north])


def require_degrees(path: Path, latitude: float, longitude: float) -> None:
    """Raises TrajectoryError where these are no degrees of a place on Earth that Mercator's projection has."""
    if not (abs(latitude) < 90 and abs(longitude) <= 180):
        raise TrajectoryError(f"{path}: {latitude:g}, {longitude:g} are no degrees of latitude and longitude")


def read_packets(files: list[Path]) -> NDArray[np.float64]:
    """Latitude, longitude (degrees), altitude (m), roll, pitch, yaw (rad) of each packet, (N, 6).

    Raises:
        TrajectoryError: A packet is not of this form.
    """
    packets = []
    for file in files:
        try:
            packet = [float(word) for word in read_text(file, TrajectoryError).split()[:6]]
        except (TrajectoryError, ValueError):
            packet = []
        if len(packet) != 6 or not np.all(np.isfinite(packet)):
            raise TrajectoryError(f"{file} is not an OXTS packet: it should begin with six finite numbers")
        require_degrees(file, packet[0], packet[1])
        packets.append(packet)
    return np.array(packets).reshape(-1, 6)


def packet_poses(packets: NDArray[np.float64]) -> list[gtsam.Pose3]:
    """world_T_imu of packets (N, 6); world axes are east, north, up, the unit's are forward, left, up."""
    positions = np.column_stack([mercator(packets[:, 0], packets[:, 1]), packets[:, 2]])
    return [
        gtsam.Pose3(gtsam.Rot3.RzRyRx(roll, pitch, yaw), position)
        for (roll, pitch, yaw), position in zip(packets[:, 3:], positions, strict=True)
    ]


def read_timestamps(path: Path) -> NDArray[np.datetime64]:
    """One `2011-09-26 13:02:25.967790592` a line, (N,) with all nanoseconds; NaT where a line is empty.

    KITTI leaves the line of a lost image empty.

    Raises:
        SequenceError: The file cannot be read or a line is not a time.
    """
    lines = [line.strip() for line in read_text(path, SequenceError).rstrip().splitlines()]
    for number, line in enumerate(lines, 1):
        if line and not _TIME.fullmatch(line):
            raise SequenceError(f"{path}: line {number} is not a date and time: '{line[:60]}'")
    try:
        return np.array([line or "NaT" for line in lines], "datetime64[ns]")
    except ValueError as error:  # a thirteenth month
        raise SequenceError(f"{path}: {error}") from None


def seconds_since(origin: np.datetime64, stamps: NDArray[np.datetime64]) -> NDArray[np.float64]:
    """Seconds from `origin`, (N,), NaN for NaT."""
    return (stamps - origin) / np.timedelta64(1, "s")
