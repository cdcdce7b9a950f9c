"""The ground plane below the camera: what a format knows of it and what the user says of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sequence import MOUNTING_SIGMA, Ground, Sequence
from fvslam_graph.sequences.files import count_of

# How far a camera tilts against the ground, standard deviations in radians.
CAR_TILT = 0.01  # a car pitches on its springs, and the mounting is not quite level
GIVEN_TILT = 0.05  # the user knows the mounting; the vehicle still moves
UAV_TILT = 0.3  # a multirotor tilts to accelerate, and its attitude is not known

STRAIGHT_DOWN = 1.571  # rad, as pi/2 is written by hand

KITTI_CAMERA_HEIGHT = 1.65  # metres above the road (Geiger et al. 2013, Fig. 3)


def level_ground(heights: NDArray[np.float64], tilt: float, source: str, common_sigma: float = 0.0) -> Ground:
    """The ground below a camera that looks to the horizon, heights (N,) in metres."""
    return Ground(heights, np.array([0.0, 1.0, 0.0]), tilt, source, common_sigma=common_sigma)


def altimeter_readings(
    readings: NDArray[np.float64], source: str
) -> tuple[NDArray[np.float64], float, tuple[str, ...]]:
    """Heights above the ground as an altimeter knows them: no better than its smallest step, and not nearer than that.

    Args:
        readings: (N,) metres; NaN where it has none.
        source: Of the readings, for messages.

    Returns:
        Heights (N,), all NaN where the altimeter says nothing; its smallest step, metres; notes.

    Raises:
        SequenceError: Most readings are below zero.
    """
    known = np.unique(readings[np.isfinite(readings)])
    nothing = np.full(len(readings), np.nan)
    if not len(known):
        return nothing, 0.0, ()
    below = int(np.sum(readings < 0))
    if 2 * below > np.isfinite(readings).sum():
        raise SequenceError(
            f"{source}: {below} of {len(readings)} heights are below zero; heights are metres above the ground, upwards"
        )
    resolution = round(float(np.diff(known).min()), 6) if len(known) > 1 else 0.0
    if resolution == known[-1] == 0:
        return nothing, 0.0, (f"{source}: the heights are zero throughout, and are not used",)
    notes = (f"{count_of(below, 'height')} below zero, taken as {resolution:g} m",) if below else ()
    return np.where(np.isfinite(readings), np.maximum(readings, resolution), np.nan), resolution, notes


def kitti_ground(frames: int) -> Ground:
    """The road below the cameras of KITTI's car."""
    heights = np.full(frames, KITTI_CAMERA_HEIGHT)
    return level_ground(heights, CAR_TILT, "KITTI: camera 1.65 m above the road", MOUNTING_SIGMA)


def override_ground(sequence: Sequence, height: float | None, pitch: float | None) -> Sequence:
    """The sequence with what the user gives of the ground, as `given_ground` takes it."""
    return replace(sequence, ground=given_ground(sequence.name, sequence.ground, len(sequence), height, pitch))


def given_ground(
    name: str, known: Ground | None, frames: int, height: float | None, pitch: float | None
) -> Ground | None:
    """The ground that is known of a recording, with the camera height or pitch that the user gives.

    Args:
        name: Of the recording, for the error message.
        known: What it knows itself.
        frames: How many it has.
        height: Metres; None where the user gives none.
        pitch: Radians, positive: nose down; likewise.

    Raises:
        SequenceError: A value out of range, or a pitch alone where no height is known.
    """
    if height is not None and not 0 < height < np.inf:
        raise SequenceError(f"the camera height must be a positive number of metres, not {height:g}")
    if pitch is not None and not abs(pitch) <= STRAIGHT_DOWN:
        raise SequenceError(f"the camera pitch must be between -pi/2 and pi/2 radians, not {pitch:g}")

    ground = known
    if height is not None:
        heights = np.full(frames, float(height))
        ground = replace(known or level_ground(heights, UAV_TILT, "given"), heights=heights)
        ground = replace(ground, height_sigma=0.0, common_sigma=MOUNTING_SIGMA, source="given")
    if pitch is not None:
        if ground is None:
            raise SequenceError(f"{name} has no ground height: give the camera height along with its pitch")
        normal = np.array([0.0, np.cos(pitch), np.sin(pitch)])
        ground = replace(ground, normal=normal, normal_sigma=min(ground.normal_sigma, GIVEN_TILT))
    return ground


def with_ground_plane(sequence: Sequence, plane: Iterable[float]) -> Sequence:
    """The sequence with the ground plane that the user gives.

    Args:
        sequence: Any.
        plane: nx, ny, nz, the direction from the camera down to the plane, and its distance in metres.

    Raises:
        SequenceError: These are no such four numbers.
    """
    numbers = np.array(tuple(plane), float)
    if len(numbers) != 4 or not np.isfinite(numbers).all() or not numbers[:3].any() or not numbers[3] > 0:
        raise SequenceError(
            "the ground plane is nx ny nz d: the direction from the camera down to it, and its distance in metres"
        )
    heights = np.full(len(sequence), numbers[3])
    normal = numbers[:3] / np.linalg.norm(numbers[:3])
    ground = Ground(heights, normal, GIVEN_TILT, "given plane", common_sigma=MOUNTING_SIGMA)
    return replace(sequence, ground=ground)
