"""A video file with its calibration beside it: `flight.mp4` and `flight.yaml`, or `camera.yaml`; and `times.csv`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Distortion, Image, Rectifier
from fvslam_graph.core.errors import CameraError, SequenceError
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.sequences.calibration import Calibration, read_calibration
from fvslam_graph.sequences.plausibility import MAX_VIEW, MIN_VIEW
from fvslam_graph.sequences.tables import MAX_RATE, MIN_RATE, MIN_STEP, even_stamps
from fvslam_graph.sequences.times import TIMES, Times, read_times

FORMAT = "video"
LAYOUT = "a video file with a .yaml of the same name or a camera.yaml beside it"

VIDEO_SUFFIXES = {".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg"}
DEFAULT_RATE = 30.0  # Hz
WHOLE = 0.95  # of the frames that a header promises; some count from the duration
UNSTEADY = 0.003  # seconds between two steps from which on a note says so; some files hold milliseconds


def matches(path: Path) -> bool:
    """Whether this is a video file, by its suffix."""
    return path.is_file() and path.suffix.lower() in VIDEO_SUFFIXES


def read(path: Path, fov: float | None = None) -> Sequence:
    """Open a video; stamps are those of a `times.csv` beside it, or those that its frames are decoded with.

    Args:
        path: The file.
        fov: Degrees that the image is wide, where there is no calibration, or instead of it.

    Raises:
        SequenceError: It cannot be decoded, or `times.csv` is of another video.
        CameraError: There is no calibration, one of images of another size, or no such field of view.
    """
    video = Video(path)
    calibration, source = (_by_width(video, fov), path) if fov is not None else _beside(path)
    camera = calibration.camera
    if video.size != (camera.width, camera.height):
        raise CameraError(
            f"{path} is {video.size[0]}x{video.size[1]} pixels, but {source} is for {camera.width}x{camera.height}"
        )
    times = path.parent / TIMES
    listed = _listed(video, times) if times.exists() else _decoded(video, calibration.rate)
    return Sequence(
        name=path.stem,
        format=FORMAT,
        camera=camera.undistorted(),
        stamps=listed.stamps,
        load=video.loader(camera),
        ground=listed.ground,
        notes=calibration.notes + listed.notes + _cut_off(video),
    )


def _beside(path: Path) -> tuple[Calibration, Path]:
    """The calibration beside a video, and its file."""
    candidates = [path.with_suffix(".yaml"), path.parent / "camera.yaml"]
    source = next((file for file in candidates if file.exists()), None)
    if source is None:
        raise CameraError(
            f"{path} has no calibration beside it: write {candidates[0].name} or {candidates[1].name}, "
            "or give the field of view (--fov DEGREES)"
        )
    return read_calibration(source), source


def _by_width(video: Video, fov: float) -> Calibration:
    """A camera without distortion whose image is `fov` degrees wide."""
    if not MIN_VIEW <= fov <= MAX_VIEW:
        raise CameraError(
            f"the field of view must be {MIN_VIEW:g} to {MAX_VIEW:g} degrees from side to side, not {fov:g}"
        )
    width, height = video.size
    focal = width / 2 / np.tan(np.radians(fov) / 2)
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    return Calibration(camera, notes=(f"the camera is one whose image is {fov:g} degrees wide, without distortion",))


def _listed(video: Video, times: Path) -> Times:
    """Stamps and heights as `times.csv` lists them, for the frames that can be decoded."""
    listed, frames = read_times(times), len(video.stamps)
    if len(listed.stamps) < frames:
        raise SequenceError(
            f"{times} has {len(listed.stamps)} rows, but the video has {frames} frames: complete it, or remove it"
        )
    ground = listed.ground and replace(listed.ground, heights=listed.ground.heights[:frames])
    notes = listed.notes
    if len(listed.stamps) > frames:
        notes += (f"{times.name} has {len(listed.stamps)} rows, of which the first {frames} are used",)
    return replace(listed, stamps=listed.stamps[:frames], ground=ground, notes=notes)


def _decoded(video: Video, given: float | None) -> Times:
    """Seconds of each frame by the decoder; where it knows none, evenly spaced ones."""
    steps = np.diff(video.stamps)
    if np.all(steps > MIN_STEP) and (not len(steps) or MIN_RATE <= 1 / np.median(steps) <= MAX_RATE):
        notes: tuple[str, ...] = ()
        if len(steps) and np.ptp(steps) > UNSTEADY:
            low, high = 1000 * steps.min(), 1000 * steps.max()
            notes = (f"the frame rate varies: {low:.0f} to {high:.0f} ms between frames",)
        return Times(None, video.stamps, None, notes)
    known = next((rate for rate in (given, video.rate) if rate and MIN_RATE <= rate <= MAX_RATE), None)
    rate = known or DEFAULT_RATE
    note = f"the video has no times of its frames, {rate:g} Hz is {'taken' if known else 'assumed'}"
    return Times(None, even_stamps(len(video.stamps), rate), None, (note,))


def _cut_off(video: Video) -> tuple[str, ...]:
    if len(video.stamps) > WHOLE * video.claimed:
        return ()
    return (f"the file says {video.claimed} frames, {len(video.stamps)} of them can be decoded",)


class Video:
    """A video file that is kept open and read on; a frame behind is reached from the start.

    There is no seeking: where the frame rate varies, or a file has no index, it ends at other frames than asked for.

    Args:
        path: The file.

    Attributes:
        stamps: (N,) seconds since the first frame, as decoded: what the header says of their number and rate may be
            wrong.
        rate: Frames a second, as the header says; 0 where it does not.
        claimed: The number of frames, likewise.
        size: Width, height of the first frame, pixels.

    Raises:
        SequenceError: The file cannot be decoded.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._capture = cv2.VideoCapture(str(path))
        self._next = 0  # the frame that the capture stands at
        first = self._read(0)
        if first is None:
            raise SequenceError(f"{path} cannot be decoded as a video")
        self.size = (first.shape[1], first.shape[0])
        self.rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        self.claimed = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        status = path.stat()
        self.stamps = _decoded_stamps(path, status.st_size, status.st_mtime_ns)

    def loader(self, camera: Camera) -> Callable[[int], Image | None]:
        """Reads frame i as rectified (H, W) uint8, None where it cannot be decoded; `camera` is the one as built."""
        rectifier = None if camera.distortion is Distortion.NONE else Rectifier(camera, camera.undistorted())

        def load(index: int) -> Image | None:
            image = self.frame(index)
            return image if image is None or rectifier is None else rectifier(image)

        return load

    def frame(self, index: int) -> Image | None:
        """Frame `index` as it is, (H, W) uint8; None where it cannot be decoded."""
        image = self._read(index)
        return None if image is None or (image.shape[1], image.shape[0]) != self.size else image

    def _read(self, index: int) -> Image | None:
        if index < self._next:
            self._capture = cv2.VideoCapture(str(self._path))
            self._next = 0
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


@lru_cache(maxsize=16)
def _decoded_stamps(path: Path, _size: int, _changed: int) -> NDArray[np.float64]:
    """Seconds of all frames, (N,), by decoding the whole file, which is remembered while it does not change."""
    capture = cv2.VideoCapture(str(path))
    stamps: list[float] = []
    while capture.grab():
        stamps.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
    return np.array(stamps, float) - stamps[:1]
