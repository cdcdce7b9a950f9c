"""A video file with its calibration beside it: `flight.mp4` and `flight.yaml`, or `camera.yaml`."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from fvslam_graph.camera import Camera, Distortion, Image, Rectifier
from fvslam_graph.errors import CameraError, SequenceError
from fvslam_graph.sequences.base import Sequence
from fvslam_graph.sequences.calibration import read_camera
from fvslam_graph.sequences.tables import even_stamps

FORMAT = "video"
LAYOUT = "a video file with a .yaml of the same name or a camera.yaml beside it"

SUFFIXES = {".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg"}
DEFAULT_RATE = 30.0  # Hz
MAX_SKIP = 100  # frames: a short way forward is read through, as a seek decodes from the last key frame anyway


def matches(path: Path) -> bool:
    """Whether this is a video file, by its suffix."""
    return path.is_file() and path.suffix.lower() in SUFFIXES


def read(path: Path) -> Sequence:
    """Open a video; stamps are counted from its frame rate."""
    candidates = [path.with_suffix(".yaml"), path.parent / "camera.yaml"]
    calibration = next((file for file in candidates if file.is_file()), None)
    if calibration is None:
        raise CameraError(f"{path} has no calibration beside it: write {candidates[0].name} or {candidates[1].name}")
    camera = read_camera(calibration)
    video = Video(path, camera)
    if video.size != (camera.width, camera.height):
        raise CameraError(
            f"{path} is {video.size[0]}x{video.size[1]} pixels, but {calibration} is for {camera.width}x{camera.height}"
        )
    known = 0 < video.rate < np.inf
    return Sequence(
        name=path.stem,
        format=FORMAT,
        camera=camera.undistorted(),
        stamps=even_stamps(video.frames, video.rate if known else DEFAULT_RATE),
        load=video.load,
        notes=() if known else (f"the video has no frame rate, {DEFAULT_RATE:g} Hz is assumed",),
    )


class Video:
    """A video file that is kept open and read on, as seeking for every frame would decode each many times.

    Args:
        path: The file.
        camera: The camera as built; where it has distortion, frames are rectified.

    Attributes:
        frames: How many there are; counted where the file does not say, as one that was cut off does not.
        rate: Frames a second, as the file says; 0 where it does not.
        size: Width, height of the first frame, pixels.

    Raises:
        SequenceError: The file cannot be decoded.
    """

    def __init__(self, path: Path, camera: Camera) -> None:
        self._path = path
        self._capture = cv2.VideoCapture(str(path))
        self._next = 0  # the frame that the capture stands at
        first = self._read(0)
        if first is None:
            raise SequenceError(f"{path} cannot be decoded as a video")
        self.size = (first.shape[1], first.shape[0])
        self.rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.frames = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if self.frames < 1:
            while self._capture.grab():
                self._next += 1
            self.frames = self._next
        self._rectifier = None if camera.distortion is Distortion.NONE else Rectifier(camera, camera.undistorted())

    def load(self, index: int) -> Image | None:
        """Frame `index` as rectified (H, W) uint8; None where it cannot be decoded."""
        image = self._read(index)
        if image is None or (image.shape[1], image.shape[0]) != self.size:
            return None
        return image if self._rectifier is None else self._rectifier(image)

    def _read(self, index: int) -> Image | None:
        if index < self._next:  # opened anew, as a file without an index cannot seek back
            self._capture = cv2.VideoCapture(str(self._path))
            self._next = 0
        if index > self._next + MAX_SKIP:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, index)
            self._next = index
        while self._next < index and self._capture.grab():
            self._next += 1
        if self._next < index:  # the file ends before
            return None
        self._next += 1
        good, image = self._capture.read()
        if not good:
            return None
        gray: Image = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        return gray
