"""Images of a recording: a few looked at on opening, each decoded when it is asked for."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import MAX_SIDE, Camera, Distortion, Image, Rectifier
from fvslam_graph.core.errors import CameraError, SequenceError
from fvslam_graph.sequences.files import count_of, ranges

MAX_BYTES = 500_000_000  # of a file; the largest image has 200 MB, uncompressed
IMAGES_LOOKED_AT = 10  # images that are looked at on opening, spread over the recording
DEPTHS = (8, 10, 12, 14, 16)  # bits that cameras have

_PNG, _PNG_END = b"\x89PNG", b"IEND\xaeB`\x82"
_JPEG, _JPEG_END = b"\xff\xd8", b"\xd9"
_JPEG_MARKER = re.compile(rb"\xff+([^\x00\xff\xd0-\xd7])")  # apart from those within the compressed data

Levels = NDArray[np.uint8] | NDArray[np.uint16]


class Named(Hashable, Protocol):
    """The source of an image: the path of a file, the place of a message. `str` tells it in full."""

    @property
    def name(self) -> str:
        """The shortest name that tells it from the others of a recording."""


_S = TypeVar("_S", bound=Named)


def decode(path: Path) -> Levels | None:
    """The gray levels of an image file, (H, W), in the depth that it has; None where there are none to read.

    Colour becomes luma. Floating-point and 32-bit levels have no scale that is known, and are not read.
    """
    try:
        readable = path.is_file() and path.stat().st_size <= MAX_BYTES  # a pipe would wait for ever
        return decode_bytes(path.read_bytes()) if readable else None
    except OSError:
        return None


def decode_bytes(data: bytes) -> Levels | None:
    """The gray levels of what an image file holds; see `decode`."""
    if not _whole(data):
        return None
    try:
        levels: Levels | None = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    except cv2.error:
        return None
    return levels if levels is not None and levels.dtype in (np.uint8, np.uint16) else None


def _whole(data: bytes) -> bool:
    """Whether an image file goes on to its end, where its format tells, and has a size that can be held in memory.

    Decoders fill the rest of a truncated image with gray and say nothing. What comes after the end does not matter:
    cameras add previews, recorders add zeros.
    """
    if data.startswith(_PNG):
        sides = (int.from_bytes(data[start : start + 4], "big") for start in (16, 20))
        return data.rfind(_PNG_END) > 0 and max(sides) <= MAX_SIDE
    if data.startswith(_JPEG):
        if data.rstrip(b"\0").endswith(b"\xff" + _JPEG_END):
            return True
        position = len(_JPEG)
        while marker := _JPEG_MARKER.search(data, position):
            if marker[1] == _JPEG_END:
                return True
            position = marker.end() + int.from_bytes(data[marker.end() : marker.end() + 2], "big")  # its segment
        return False
    return bool(data)


def eight_bits(levels: Levels, depth: int) -> Image:
    """Gray levels as (H, W) uint8; of 16 bits, `depth` are used, of which the upper 8 are kept."""
    if levels.dtype == np.uint8:
        return np.asarray(levels, np.uint8)
    return np.asarray(np.minimum(levels >> (depth - 8), 255), np.uint8)


class Images(Generic[_S]):
    """The images of a recording, of which a few are looked at.

    Args:
        sources: What each frame's image is decoded from; None where a frame has none.
        decode: Makes gray levels (H, W) of a source, or None where there are none to read.

    Attributes:
        size: Width, height of most of them, pixels.
        depth: Bits that those of 16 bits use, the same in every image, so that brightness stays comparable.

    Raises:
        SequenceError: No image can be decoded.
    """

    def __init__(self, sources: Sequence[_S | None], decode: Callable[[_S], Levels | None]) -> None:
        self._sources, self._decode = sources, decode
        known = [source for source in sources if source is not None]
        if not known:
            raise SequenceError("the recording lists no images")
        chosen = sorted(set(np.linspace(0, len(known) - 1, IMAGES_LOOKED_AT).round().astype(int).tolist()))
        levels = {source: decode(source) for source in (known[index] for index in chosen)}
        if all(image is None for image in levels.values()):
            found = ((source, image) for source in known if (image := decode(source)) is not None)
            source, image = next(found, (known[0], None))
            if image is None:
                raise SequenceError(
                    f"none of the {len(known)} images can be decoded, the first is {source}; "
                    f"read are 8 and 16 bits, up to {MAX_SIDE} pixels a side"
                )
            levels[source] = image
        self._sizes = {source: image.shape[::-1] for source, image in levels.items() if image is not None}
        self._undecoded = [source for source, image in levels.items() if image is None]
        self.size: tuple[int, int] = Counter(self._sizes.values()).most_common(1)[0][0]
        deep = [image for image in levels.values() if image is not None and image.dtype == np.uint16]
        self._lowest = min((int(image.min()) for image in deep), default=0)
        self._highest = max((int(image.max()) for image in deep), default=2**16 - 1)
        self.depth = next(depth for depth in DEPTHS if self._highest < 2**depth)

    def loader(
        self, camera: Camera, calibration: Path | str, rectifier: Rectifier | None = None
    ) -> Callable[[int], Image | None]:
        """A function that reads image i: decoded, of the right size, rectified; None where it is unusable.

        Args:
            camera: The camera as built, which made the images.
            calibration: Where the camera comes from, for the error message.
            rectifier: How to rectify; where not given, distortion is removed and the calibration matrix stays.

        Raises:
            CameraError: No image that was looked at is of the calibrated size.
        """
        size = (camera.width, camera.height)
        if size not in self._sizes.values():
            source, (width, height) = next(iter(self._sizes.items()))
            raise CameraError(f"{source} is {width}x{height} pixels, but {calibration} is for {size[0]}x{size[1]}")
        if rectifier is None and camera.distortion is not Distortion.NONE:
            rectifier = Rectifier(camera, camera.undistorted())
        sources, decode, depth = self._sources, self._decode, self.depth

        def load(index: int) -> Image | None:
            source = sources[index]
            levels = None if source is None else decode(source)
            if levels is None or levels.shape[::-1] != size:
                return None
            image = eight_bits(levels, depth)
            return image if rectifier is None else rectifier(image)

        return load

    def notes(self, camera: Camera) -> tuple[str, ...]:
        """Notes on what is odd about the images of a camera, one sentence each."""
        other = [source for source, size in self._sizes.items() if size != (camera.width, camera.height)]
        looked_at = f"of the {len(self._sizes) + len(self._undecoded)} images looked at"
        notes = []
        if self._undecoded:
            notes.append(f"{len(self._undecoded)} {looked_at} cannot be decoded, such as {self._undecoded[0].name}")
        if other:
            notes.append(
                f"{len(other)} {looked_at} are not of {camera.width}x{camera.height} pixels and left out, "
                f"such as {other[0].name}"
            )
        if self.depth < DEPTHS[-1]:
            notes.append(
                f"images of 16 bits hold levels from {self._lowest} to {self._highest}: taken as {self.depth} bits"
            )
        return tuple(notes)


class ImageFiles(Images[Path]):
    """The image files of a recording.

    Args:
        paths: One file per frame; None where a frame has none.
    """

    def __init__(self, paths: Sequence[Path | None]) -> None:
        super().__init__(paths, decode)
        self._missing = [index for index, path in enumerate(paths) if path is None or not path.is_file()]
        self._undecoded = [path for path in self._undecoded if path.is_file()]

    def notes(self, camera: Camera) -> tuple[str, ...]:
        """Notes on what is odd about the files of a camera, one sentence each."""
        notes = super().notes(camera)
        if not self._missing:
            return notes
        return (f"{count_of(len(self._missing), 'image')} missing: frame {ranges(self._missing)}", *notes)
