"""Effects that a real camera adds to a rendered image: blur, exposure, noise, lost frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image
from fvslam_graph.core.random_streams import stream
from fvslam_graph.simulation.worlds.ripmap import Grey
from fvslam_graph.simulation.worlds.waves import Waves

_JUMP = 4.7  # seconds between sudden changes of exposure


@dataclass(frozen=True, eq=False)
class Effects:
    """Makes image i from what the world looks like around its stamp; nothing depends on other images.

    Attributes:
        stamps: (N,) seconds.
        interval: Seconds between frames.
        noise: Standard deviation of the pixels' Gaussian noise, grey values.
        blur: Exposure time as a share of the interval between frames; the stamp is at its middle.
        exposure: Relative size of changes of brightness, slow ones and one jump every few seconds.
        drop: Share of the images that are lost, never the first.
        seed: Of noise, exposure and losses.
    """

    stamps: NDArray[np.float64]
    interval: float
    noise: float
    blur: float
    exposure: float
    drop: float
    seed: int

    def dropped(self) -> NDArray[np.int64]:
        """Numbers of the lost images, sorted."""
        rng = stream(self.seed, "drop")
        count = min(round(self.drop * len(self.stamps)), len(self.stamps) - 1)
        return np.sort(rng.choice(np.arange(1, len(self.stamps)), count, replace=False))

    def apply(self, index: int, render: Callable[[float], Grey]) -> Image:
        """Image `index`, (H, W) uint8; `render` shows the world at a time in seconds."""
        stamp = float(self.stamps[index])
        grey = np.mean([render(stamp + delay) for delay in self._delays()], axis=0, dtype=np.float32)
        if self.exposure:
            gain, offset = self._exposure(stamp)
            grey = gain * grey + offset
        if self.noise:
            rng = stream(self.seed, "noise", index)
            grey = grey + np.float32(self.noise) * rng.standard_normal(grey.shape, np.float32)
        image: Image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
        return image

    def _delays(self) -> NDArray[np.float64]:
        """Moments of the exposure relative to the stamp, seconds; motion in between is a pixel or two."""
        if self.blur == 0:
            return np.zeros(1)
        count = 1 + int(np.ceil(16 * self.blur))
        return self.blur * self.interval * ((np.arange(count) + 0.5) / count - 0.5)

    def _exposure(self, stamp: float) -> tuple[np.float32, np.float32]:
        rng = stream(self.seed, "exposure")
        slow, offset = Waves.random(rng, (0.7, 7.0), (0.3, 2.9)), Waves.random(rng, (20.0, 5.0))
        levels = rng.uniform(-0.5, 0.5, int(stamp // _JUMP) + 1)
        gain = np.exp(self.exposure * (slow(stamp) + levels[-1]))
        return np.float32(gain), np.float32(self.exposure * offset(stamp))
