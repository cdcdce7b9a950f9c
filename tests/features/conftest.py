"""An image that can be moved by any fraction of a pixel without interpolation."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

WIDTH, HEIGHT = 320, 240

MakeTexture = Callable[..., NDArray[np.uint8]]


@pytest.fixture(scope="session")
def texture() -> MakeTexture:
    """Makes a random image, moved by `shift` (right, down) pixels: exactly, as its spectrum is, around the edges."""

    def make(
        shift: tuple[float, float] = (0.0, 0.0), seed: int = 0, noise: float = 0.0, band: float = 0.09
    ) -> NDArray[np.uint8]:
        rng = np.random.default_rng(seed)
        across, down = np.fft.fftfreq(WIDTH), np.fft.fftfreq(HEIGHT)[:, None]
        spectrum = np.fft.fft2(rng.standard_normal((HEIGHT, WIDTH))) * np.exp(-(across**2 + down**2) / (2 * band**2))
        spectrum *= np.exp(-2j * np.pi * (across * shift[0] + down * shift[1]))
        image = np.fft.ifft2(spectrum).real
        image = 128 + 40 * image / image.std()
        image += noise * np.random.default_rng(hash((seed, *shift)) % 2**32).standard_normal(image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    return make
