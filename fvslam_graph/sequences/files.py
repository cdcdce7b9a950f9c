"""Image files of a recording: found by name, decoded one at a time."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from fvslam_graph.camera import Camera, Distortion, Image, Rectifier
from fvslam_graph.errors import CameraError, SequenceError

IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".bmp", ".tif", ".tiff", ".webp"}

_DIGITS_OR_TEXT = re.compile(r"(\d+)|(\D+)")

# What a file of this kind begins and ends with. Some decoders fill the rest of a truncated image with gray and say
# nothing, so a file without its end is not decoded at all.
_SIGNATURES = ((b"\x89PNG", b"IEND\xaeB`\x82"), (b"\xff\xd8", b"\xff\xd9"))


def read_gray(path: Path) -> Image | None:
    """An image file as (H, W) uint8; None where it is missing, truncated or cannot be decoded.

    Colour becomes luma. Of 16 bits the upper 8 are kept, the same in every image, so that brightness stays comparable.
    """
    try:
        data = path.read_bytes()
        ending = next((end for start, end in _SIGNATURES if data.startswith(start)), b"")
        if not data.rstrip(b"\0").endswith(ending):  # some recorders pad their files with zeros
            return None
        image: Image | None = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    except (OSError, cv2.error):
        return None
    return image


def first_image(paths: Sequence[Path | None]) -> tuple[Path, Image]:
    """The first image that can be decoded, with its path; raises SequenceError where there is none."""
    files = [path for path in paths if path is not None]
    for path in files:
        if (image := read_gray(path)) is not None:
            return path, image
    if not files:
        raise SequenceError("the recording lists no images")
    raise SequenceError(f"none of the {len(files)} images can be decoded, the first is {files[0]}")


def open_images(
    paths: Sequence[Path | None], camera: Camera, calibration: Path | str, rectifier: Rectifier | None = None
) -> Callable[[int], Image | None]:
    """A function that reads image i: decoded, of the right size, rectified; None where it is unusable.

    Args:
        paths: One file per frame; None where a frame has none.
        camera: The camera as built, which made the files.
        calibration: Where the camera comes from, for the error message.
        rectifier: How to rectify; where not given, distortion is removed and the calibration matrix stays.

    Raises:
        CameraError: The first image is not of the calibrated size.
        SequenceError: No image can be decoded.
    """
    size = (camera.height, camera.width)
    path, image = first_image(paths)
    if image.shape != size:
        raise CameraError(
            f"{path} is {image.shape[1]}x{image.shape[0]} pixels, but {calibration} is for "
            f"{camera.width}x{camera.height}"
        )
    if rectifier is None and camera.distortion is not Distortion.NONE:
        rectifier = Rectifier(camera, camera.undistorted())

    def load(index: int) -> Image | None:
        path = paths[index]
        image = None if path is None else read_gray(path)
        if image is None or image.shape != size:
            return None
        return image if rectifier is None else rectifier(image)

    return load


def image_files(folder: Path) -> list[Path]:
    """The images in a folder in natural order: 2.png comes before 10.png."""
    files = (
        path
        for path in folder.iterdir()
        if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".") and path.is_file()
    )
    return sorted(
        files, key=lambda path: [(int(digits or -1), text) for digits, text in _DIGITS_OR_TEXT.findall(path.name)]
    )


def numbered_images(folder: Path, prefix: str = "") -> dict[int, Path]:
    """The images named `prefix` and a number, by number and in its order; raises SequenceError where there is none."""
    name = re.compile(re.escape(prefix) + r"(\d+)")
    files = {int(match[1]): path for path in image_files(folder) if (match := name.fullmatch(path.stem))}
    if not files:
        raise SequenceError(f"{folder} holds no images named {prefix}000000.png, {prefix}000001.png, ...")
    return dict(sorted(files.items()))


def missing_note(paths: Sequence[Path | None]) -> tuple[str, ...]:
    """A note on the frames without a file, or none."""
    missing = [index for index, path in enumerate(paths) if path is None or not path.is_file()]
    return (f"{count_of(len(missing), 'image')} missing: frame {ranges(missing)}",) if missing else ()


def count_of(number: int, noun: str) -> str:
    """`1 image is`, `2 images are`: the subject of a note."""
    return f"{number} {noun} is" if number == 1 else f"{number} {noun}s are"


def ranges(numbers: Sequence[int]) -> str:
    """Increasing numbers for the eye: [1, 2, 3, 7] is `1-3, 7`."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1][1:] = [number]
        else:
            runs.append([number])
    return ", ".join("-".join(map(str, run)) for run in runs)


def only_one(folder: Path, found: Sequence[Path], noun: str) -> Path:
    """The one candidate; raises SequenceError where there is none, and one that lists them where there are several."""
    if not found:
        raise SequenceError(f"{folder} holds no {noun}")
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise SequenceError(f"{folder} holds {len(found)} {noun}s, give one of them: {names}")
    return found[0]
