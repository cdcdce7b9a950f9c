"""Where the world of a run is on Earth: by fixes of a GNSS receiver, or by what a user says of its first pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.extras import require
from fvslam_graph.core.sensors import SensorSeries
from fvslam_graph.core.trajectory import Trajectory

Array = NDArray[np.float64]

MIN_FIXES = 3  # points that determine a similarity
STRAIGHT = 3.0  # RMS distances from the fixes; a path that leaves a straight line by less is straight,
MIN_ASIDE = 0.1  # metres, and by less than this
MIN_SPREAD = 1.0  # metres between fixes, below which they tell no direction


@dataclass(frozen=True)
class Georeference:
    """The similarity that takes the world of a run to east, north, up at a place.

    Attributes:
        origin: (3,) latitude, longitude (degrees, WGS84) and altitude (m) of the place.
        scale: Metres on Earth per metre of the run.
        rotation: enu_R_world, (3, 3).
        translation: (3,) of the world's origin in east, north, up, metres.
        note: How it came about.
    """

    origin: Array
    scale: float
    rotation: Array
    translation: Array
    note: str

    @classmethod
    def by_origin(cls, origin: Sequence[float], down: Sequence[float] | None) -> Self:
        """Put the first camera at a given place, looking in a given direction.

        Args:
            origin: Latitude, longitude (degrees, WGS84), altitude (m) and, if given, heading: degrees clockwise from
                north to where the first camera looks, or to where the upper rim of its image is if it looks down.
            down: (3,) direction of gravity in the first camera; without it, this camera is taken to be level.

        Raises:
            ResultsError: These are no such numbers.
        """
        if len(origin) not in (3, 4) or not np.isfinite(origin).all() or abs(origin[0]) > 90 or abs(origin[1]) > 180:
            raise ResultsError(
                f"the origin is LAT,LON,ALT or LAT,LON,ALT,HEADING in degrees and metres, not {_joined(origin)}"
            )
        heading = np.radians(origin[3] if len(origin) == 4 else 0.0)
        sine, cosine = np.sin(heading), np.cos(heading)
        enu = np.array([[sine, cosine, 0], [cosine, -sine, 0], [0, 0, 1]])  # rows: forward, right, up
        level = "" if down is not None else ", which is taken to be level"
        note = f"the first camera{level} is at the given origin, and heads {np.degrees(heading):g} degrees from north"
        return cls(np.array(origin[:3]), 1.0, enu.T @ _level_axes(down), np.zeros(3), note)

    @classmethod
    def by_fixes(cls, fixes: SensorSeries, trajectory: Trajectory) -> Self:
        """Bring a trajectory to the fixes of a GNSS receiver, by least squares, with a scale of its own.

        Raises:
            ResultsError: The fixes do not determine the similarity.
            FvslamError: pymap3d is not installed.
        """
        near = trajectory.interpolate(fixes.stamps)
        places = fixes.values[np.isin(fixes.stamps, near.stamps)]
        if len(places) < MIN_FIXES:
            raise ResultsError(
                f"{fixes.source} has {len(places)} fixes while the run has poses, at least {MIN_FIXES} are needed; are "
                "its stamps of the same clock?"
            )
        enu = _to_enu(places, places[0])
        if min(np.linalg.norm(np.ptp(enu, axis=0)), np.linalg.norm(np.ptp(near.positions, axis=0))) < MIN_SPREAD:
            raise ResultsError(f"{fixes.source}: its fixes, or the poses of the run, are all within {MIN_SPREAD:g} m")
        aligned = gtsam.Similarity3.Align(list(zip(enu, near.positions, strict=True)))
        rotation, scale = aligned.rotation().matrix(), aligned.scale()
        translation = scale * aligned.translation()
        rest = enu - scale * near.positions @ rotation.T - translation
        rms = np.sqrt((rest**2).sum(axis=1).mean())
        note = f"aligned with {len(places)} fixes of {fixes.source}, {rms:.2f} m RMS apart, by a scale of {scale:.4f}"
        aside = np.linalg.svd(enu - enu.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(enu))
        if aside < max(STRAIGHT * rms, MIN_ASIDE):
            note += "; the path is so straight that they do not tell how it is turned about itself"
        return cls(places[0], scale, rotation, translation, note)

    def enu(self, points: Array) -> Array:
        """Points (N, 3) of the world as east, north, up, (N, 3), metres."""
        return self.scale * points @ self.rotation.T + self.translation

    def geodetic(self, points: Array) -> Array:
        """Points (N, 3) of the world as latitude, longitude (degrees), altitude (m), (N, 3).

        Raises:
            FvslamError: pymap3d is not installed.
        """
        require("geo")
        import pymap3d

        return np.column_stack(pymap3d.enu2geodetic(*self.enu(points).T, *self.origin))

    def covariances(self, covariances: Array) -> Array:
        """Covariances (N, 3, 3) of positions in the world as those of east, north, up, m^2."""
        return self.scale**2 * self.rotation @ covariances @ self.rotation.T


def _to_enu(places: Array, origin: Array) -> Array:
    require("geo")
    import pymap3d

    return np.column_stack(pymap3d.geodetic2enu(*places.T, *origin))


def _level_axes(down: Sequence[float] | None) -> Array:
    """Rows forward, right, up in the first camera, (3, 3)."""
    up = -np.array((0, 1, 0) if down is None else down, float)
    up /= np.linalg.norm(up)
    # Of a camera that looks steeply down (up), the upper (lower) rim of the image tells better where forward is.
    ahead = np.array([0.0, 0.0, 1.0])
    if abs(up[2]) > abs(up[1]):
        ahead = np.array([0.0, np.copysign(1.0, up[2]), 0.0])
    ahead -= up * (ahead @ up)
    ahead /= np.linalg.norm(ahead)
    return np.array([ahead, np.cross(ahead, up), up])


def _joined(numbers: Sequence[float]) -> str:
    return ",".join(f"{number:g}" for number in numbers)
