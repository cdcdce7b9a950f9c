"""East, north, up at a place on Earth (WGS84)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.extras import require

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LocalFrame:
    """The tangent plane at a place: east, north, up in metres.

    Attributes:
        origin: (3,) latitude, longitude (degrees, WGS84) and altitude (m).
    """

    origin: Array

    def enu(self, places: Array) -> Array:
        """Places (N, 3), latitude, longitude (degrees) and altitude (m), as east, north, up (N, 3).

        Raises:
            FvslamError: pymap3d is not installed.
        """
        require("geo")
        import pymap3d

        return np.column_stack(pymap3d.geodetic2enu(*np.asarray(places).T, *self.origin))

    def geodetic(self, points: Array) -> Array:
        """Points (N, 3), east, north, up, as latitude, longitude (degrees) and altitude (m), (N, 3).

        Raises:
            FvslamError: pymap3d is not installed.
        """
        require("geo")
        import pymap3d

        return np.column_stack(pymap3d.enu2geodetic(*np.asarray(points).T, *self.origin))
