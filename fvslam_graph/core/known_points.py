"""Points of an image whose depths are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class KnownPoints:
    """N points of one image with their inverse depths along the optical axis.

    Attributes:
        ids: (N,) of their tracks.
        pixels: (N, 2).
        inverse_depths: (N,) 1/metres.
        sigmas: (N,) their standard deviations, each on its own.
        common: (N, S) what each of S errors of deviation 1, which all share, adds to the inverse depths.
        log_variance: Variance of the logarithm of the scale that all depths share.
    """

    ids: NDArray[np.int64]
    pixels: NDArray[np.float64]
    inverse_depths: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    common: NDArray[np.float64]
    log_variance: float

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> KnownPoints:
        return KnownPoints(
            self.ids[chosen],
            self.pixels[chosen],
            self.inverse_depths[chosen],
            self.sigmas[chosen],
            self.common[chosen],
            self.log_variance,
        )
