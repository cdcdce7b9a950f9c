"""Recordings as other cameras would have made them: darker at the rim, under lamps, with the vehicle in view."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.simulation.disturbed import grey, repainted, texture

CORNERS = 0.5  # of the brightness that is lost in the corners of the image
EXPOSURE = 0.25  # share by which the brightness of whole images changes,
LAMPS = 0.12  # and that of rows, under lamps whose light alternates
LAMP_ROWS = 380  # rows of a period
NIGHT = 0.25  # of the brightness
NOISE = 5.0  # grey levels
QUALITY = 35  # of JPEG
BLUR = 1.5  # pixels, standard deviation
VEHICLE = 8  # times as high as the lowest rows, which show the vehicle, is the image
DIRT = 12  # specks on the lens

Effect = Callable[[Image, int], Image]
"""Makes of an image, with its index, that of another camera."""


def seen_by(sequence: Sequence, effect: Effect) -> Sequence:
    """The recording as another camera would have made it."""
    return repainted(sequence, 0, len(sequence), effect).sequence


def darker_corners(image: Image, index: int) -> Image:
    """A lens that vignettes."""
    return grey(image * _falloff(image.shape))


def changing_exposure(image: Image, index: int) -> Image:
    """Automatic exposure that never settles."""
    return grey(image * np.float32(1 + EXPOSURE * np.sin(2.1 * index)))


def lamps(image: Image, index: int) -> Image:
    """Alternating light under a rolling shutter: bands that move over the image."""
    rows = 2 * np.pi * np.arange(len(image), dtype=np.float32)[:, None] / LAMP_ROWS
    return grey(image * (1 + np.float32(LAMPS) * np.sin(rows + np.float32(1.3 * index))))


def night(image: Image, index: int) -> Image:
    """Little light."""
    return grey(image * np.float32(NIGHT))


def noisy(image: Image, index: int) -> Image:
    """A small sensor."""
    noise = np.random.default_rng(index).normal(0, NOISE, image.shape)
    return grey((image + noise).astype(np.float32))


def compressed(image: Image, index: int) -> Image:
    """A radio link with little bandwidth."""
    sent = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
    received: Image = cv2.imdecode(sent, cv2.IMREAD_GRAYSCALE)
    return received


def out_of_focus(image: Image, index: int) -> Image:
    """A lens that is not focused."""
    blurred: Image = cv2.GaussianBlur(image, (0, 0), BLUR)
    return blurred


def vehicle_in_view(image: Image, index: int) -> Image:
    """The lowest rows show the vehicle that carries the camera."""
    image, rows = image.copy(), len(image) // VEHICLE
    image[-rows:] = _surface((rows, image.shape[1]))
    return image


def letters(image: Image, index: int) -> Image:
    """The display of a flight controller."""
    image, (height, width) = image.copy(), image.shape
    cv2.putText(image, f"T+{index:05d} FLIGHT", (width // 20, height // 8), 0, width / 600, 255, 2)
    cv2.rectangle(image, (width // 20, height * 17 // 20), (width // 3, height * 19 // 20), 255, 2)
    return image


def dirt(image: Image, index: int) -> Image:
    """Specks on the lens."""
    image, (height, width), rng = image.copy(), image.shape, np.random.default_rng(0)
    for x, y, level in rng.integers(0, (width, height, 256), (DIRT, 3)).tolist():
        cv2.circle(image, (x, y), width // 50, level, -1)
    return image


EFFECTS: dict[str, Effect] = {
    "corners": darker_corners,
    "exposure": changing_exposure,
    "lamps": lamps,
    "night": night,
    "noise": noisy,
    "jpeg": compressed,
    "focus": out_of_focus,
    "vehicle": vehicle_in_view,
    "letters": letters,
    "dirt": dirt,
}


@cache
def _falloff(shape: tuple[int, int]) -> NDArray[np.float32]:
    height, width = shape
    y, x = np.ogrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    squared = (x * x * width**2 + y * y * height**2) / (width**2 + height**2)
    return np.asarray(1 - CORNERS * squared, np.float32)


@cache
def _surface(shape: tuple[int, int]) -> Image:
    return grey(texture(shape, np.random.default_rng(0)))
