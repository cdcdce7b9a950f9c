"""Recordings with something wrong in the middle, made from sound ones: by camera, driver or world."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence as Rows
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Trajectory

LENGTH = 15  # frames
DARKNESS = 5  # images
OBJECT_SPEED = 0.01  # of the image's width that a moving object crosses from frame to frame
READ_NOISE = 2.0  # grey levels, so that no two images are the same
GAINS = (0.6, 1.5)  # of the brightness


@dataclass(frozen=True)
class Disturbed:
    """A recording with a disturbance.

    Attributes:
        sequence: Its ground truth says where each image's stamp found the camera, one pose a frame; frames without
            ground truth have none.
        first: Index of the first frame that is disturbed,
        after: and of the first one that is not any more.
    """

    sequence: Sequence
    first: int
    after: int


Disturbance = Callable[[Sequence, int, np.random.Generator], Disturbed]
"""Disturbs a sequence from a frame on, with what it takes of chance."""


def rearranged(sequence: Sequence, order: Rows[int]) -> Sequence:
    """Frame k shows what frame order[k] did, and the camera was there; the stamps do not tell."""
    stamps, load, truth, ground = sequence.stamps[: len(order)], sequence.load, None, sequence.ground
    if sequence.ground_truth is not None:
        known = sequence.ground_truth.interpolate(sequence.stamps)
        poses = dict(zip(known.stamps, known.poses, strict=True))
        there = sequence.stamps[list(order)]
        seen = [k for k, stamp in enumerate(there) if stamp in poses]
        truth = Trajectory(stamps[seen], tuple(poses[there[k]] for k in seen))
    if ground is not None:
        ground = replace(ground, heights=ground.heights[list(order)])
    return replace(
        sequence, stamps=stamps, load=lambda i: load(order[i]), ground_truth=truth, ground=ground, source=None
    )


def repainted(sequence: Sequence, first: int, after: int, paint: Callable[[Image, int], Image]) -> Disturbed:
    """The frames from `first` to before `after` show what `paint(image, frames since first)` makes of them."""
    load = sequence.load

    def painted(index: int) -> Image | None:
        image = load(index)
        return image if image is None or not first <= index < after else paint(image, index - first)

    return Disturbed(replace(sequence, load=painted, source=None), first, after)


def undisturbed(sequence: Sequence, first: int, rng: np.random.Generator) -> Disturbed:
    """Nothing: what the others are held against."""
    return Disturbed(sequence, first, first + LENGTH)


def repeated(sequence: Sequence, first: int, rng: np.random.Generator) -> Disturbed:
    """One image is delivered twice, byte by byte, in place of the next one."""
    return _stuck(sequence, first, 1)


def frozen(sequence: Sequence, first: int, rng: np.random.Generator) -> Disturbed:
    """One image is delivered again and again, while the camera moves on."""
    return _stuck(sequence, first, LENGTH)


def _stuck(sequence: Sequence, first: int, count: int) -> Disturbed:
    load, after = sequence.load, first + count
    stuck = replace(sequence, load=lambda i: load(first - 1 if first <= i < after else i), source=None)
    return Disturbed(stuck, first, after)


def swapped(sequence: Sequence, first: int, rng: np.random.Generator) -> Disturbed:
    """Two neighbours come in the wrong order."""
    return _reversed(sequence, first, 2)


def reversed_order(sequence: Sequence, first: int, rng: np.random.Generator) -> Disturbed:
    """Some frames come last to first."""
    return _reversed(sequence, first, LENGTH)


def _reversed(sequence: Sequence, first: int, count: int) -> Disturbed:
    after, frames = first + count, np.arange(len(sequence))
    frames[first:after] = frames[first:after][::-1]
    return Disturbed(rearranged(sequence, frames.tolist()), first, after)


def carried_in_the_dark(sequence: Sequence, first: int, rng: np.random.Generator) -> Disturbed:
    """Some images are black, and meanwhile the camera gets much farther than their stamps allow."""
    after = first + DARKNESS
    order = [*range(after), *range(after + LENGTH, len(sequence))]
    return repainted(rearranged(sequence, order), first, after, lambda image, _: np.zeros_like(image))


def mirrored(sequence: Sequence, first: int, rng: np.random.Generator) -> Disturbed:
    """Another scene, in which the camera moves likewise, for a while."""
    return repainted(sequence, first, first + LENGTH, lambda image, _: np.ascontiguousarray(image[:, ::-1]))


def another_picture(sequence: Sequence, first: int, rng: np.random.Generator) -> Disturbed:
    """A picture in front of the lens, which does not move, for a while."""
    picture = texture((sequence.camera.height, sequence.camera.width), rng)
    noise = rng.normal(0, READ_NOISE, (LENGTH, *picture.shape)).astype(np.float32)
    return repainted(sequence, first, first + LENGTH, lambda _, k: grey(picture + noise[k]))


def moving_object(sequence: Sequence, first: int, rng: np.random.Generator) -> Disturbed:
    """A surface with texture passes by, in half of the image."""
    height, width = sequence.camera.height, sequence.camera.width
    step = max(1, round(OBJECT_SPEED * width))
    surface = texture((height, width // 2 + LENGTH * step), rng)
    noise = rng.normal(0, READ_NOISE, (LENGTH, height, width // 2)).astype(np.float32)

    def paint(image: Image, k: int) -> Image:
        image = image.copy()
        image[:, : width // 2] = grey(surface[:, k * step : k * step + width // 2] + noise[k])
        return image

    return repainted(sequence, first, first + LENGTH, paint)


def brightness_jumps(sequence: Sequence, first: int, rng: np.random.Generator) -> Disturbed:
    """The exposure changes from image to image."""
    gains = rng.uniform(*GAINS, LENGTH)
    return repainted(sequence, first, first + LENGTH, lambda image, k: grey(image * np.float32(gains[k])))


DISTURBANCES: dict[str, Disturbance] = {
    "none": undisturbed,
    "repeated": repeated,
    "frozen": frozen,
    "swapped": swapped,
    "reversed": reversed_order,
    "dark": carried_in_the_dark,
    "mirrored": mirrored,
    "picture": another_picture,
    "object": moving_object,
    "brightness": brightness_jumps,
}


def texture(shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float32]:
    """(H, W) grey levels with corners of several sizes."""
    height, width = shape
    total = np.zeros(shape, np.float32)
    for cell in (4, 12, 36):
        coarse = rng.normal(0, 1, (height // cell + 2, width // cell + 2)).astype(np.float32)
        total += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(128 + 35 * total, np.float32)


def grey(levels: NDArray[np.float32]) -> Image:
    """The image (H, W) uint8 that a camera writes."""
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)
