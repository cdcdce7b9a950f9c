"""Where images come from while they are taken: a camera, a stream, or a folder that somebody fills."""

from __future__ import annotations

import math
import os
import re
import time
from pathlib import Path

import cv2

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.sequences.files import IMAGE_SUFFIXES, stamps_in_names
from fvslam_graph.sequences.images import Levels, decode
from fvslam_graph.sequences.latest import LiveImage, LiveSource

_CAMERA = re.compile(r"[0-9]{1,3}")


def open_source(where: str) -> LiveSource:
    """The source of a number of a camera, the address of a stream, or a folder.

    Raises:
        SequenceError: It cannot be opened.
    """
    if _CAMERA.fullmatch(where) or "://" in where:
        return CaptureSource(where)
    return FolderSource(Path(where).expanduser())


class CaptureSource:
    """A camera of this machine, or a stream; stamps are the clock's when an image has come.

    Args:
        where: Number or address.

    Raises:
        SequenceError: It cannot be opened.
    """

    def __init__(self, where: str) -> None:
        number = _CAMERA.fullmatch(where) is not None
        self.name = f"camera {where}" if number else re.sub(r"//[^/@]*@", "//", where)  # without a password
        self._capture = cv2.VideoCapture(int(where)) if number else cv2.VideoCapture(where)
        if not self._capture.isOpened():
            raise SequenceError(f"{self.name} cannot be opened; check that it is there and that nobody else has it")
        self._since_1970 = time.time() - time.monotonic()  # a clock that is set must not turn back time

    def read(self) -> LiveImage | None:
        """The next image; raises EOFError where the camera or stream has gone."""
        if not self._capture.grab():
            raise EOFError
        arrived = time.monotonic()
        good, image = self._capture.retrieve()
        if not good:
            return None
        gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        return LiveImage(gray, self._since_1970 + arrived, arrived)

    def close(self) -> None:
        """Let the camera go."""
        self._capture.release()


class FolderSource:
    """A folder into which images come; those that are in it already are old.

    Stamps are what the names tell (seconds since 1970, or parts of them), else the times of the files' last change.
    An image that is not whole yet is waited for until a newer one is.

    Args:
        folder: Images come into its folder `images`, where it has one, or else into itself.

    Raises:
        SequenceError: There is no such folder.
    """

    def __init__(self, folder: Path) -> None:
        if folder.is_file():
            raise SequenceError(f"{folder} is a file, to which nothing comes; `fvslam run` takes recordings")
        if not folder.is_dir():
            raise SequenceError(f"{folder} is no folder, no number of a camera, and no address such as rtsp://...")
        self.folder = folder / "images" if (folder / "images").is_dir() else folder
        self.name = folder.resolve().name
        self._seen = self._images()
        self._stamp = -math.inf  # of the last image that was taken
        self._late = 0  # how many have come after it that are older
        self._in_parts: dict[str, int] = {}  # images that could not be decoded, with their size then

    def read(self) -> LiveImage | None:
        """The newest image that has come whole; None where there is none.

        Raises:
            SequenceError: The folder has gone.
        """
        images = self._images()
        self._seen &= images  # what is deleted need not be remembered
        self._in_parts = {name: size for name, size in self._in_parts.items() if name in images}
        new = sorted(((self._stamp_of(name), name) for name in images - self._seen), reverse=True)
        arrived = time.monotonic()
        for rank, (stamp, name) in enumerate(new):
            if stamp <= self._stamp:
                self._seen.update(late for _, late in new[rank:])
                self._late += len(new) - rank
                break
            if (levels := self._decoded(name)) is not None:
                self._seen.update(old for _, old in new[rank:])
                missed = self._late + len(new) - rank - 1
                self._stamp, self._late = stamp, 0
                return LiveImage(levels, stamp, arrived, missed)
        return None

    def close(self) -> None:
        """Nothing is held."""

    def _decoded(self, name: str) -> Levels | None:
        """The image; None where it is not whole, or has not grown since it was not."""
        path = self.folder / name
        try:
            size = path.stat().st_size
        except OSError:  # deleted meanwhile
            return None
        levels = None if self._in_parts.get(name) == size else decode(path)
        if levels is None:
            self._in_parts[name] = size
        return levels

    def _images(self) -> set[str]:
        try:
            with os.scandir(self.folder) as entries:
                names = [entry.name for entry in entries]
        except OSError as error:
            raise SequenceError(f"{self.folder} cannot be read: {error.strerror}") from None
        return {name for name in names if name[0] != "." and name[name.rfind(".") :].lower() in IMAGE_SUFFIXES}

    def _stamp_of(self, name: str) -> float:
        path = self.folder / name
        told = stamps_in_names([path])
        if told is not None:
            return float(told[0][0])
        try:
            return path.stat().st_mtime
        except OSError:  # deleted meanwhile
            return -math.inf
