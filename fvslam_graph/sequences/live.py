"""A camera as it takes images: the newest one whenever somebody is ready for it."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from threading import TIMEOUT_MAX
from types import TracebackType

import numpy as np

from fvslam_graph.core.camera import Camera, Distortion, Image, Rectifier
from fvslam_graph.core.errors import CameraError, SequenceError
from fvslam_graph.core.sequence import Frame, Ground, Sequence
from fvslam_graph.sequences.calibration import read_calibration
from fvslam_graph.sequences.ground import given_ground
from fvslam_graph.sequences.images import DEPTHS, Levels, eight_bits
from fvslam_graph.sequences.latest import LatestImage, LiveImage, LiveSource
from fvslam_graph.sequences.live_sources import FolderSource, open_source
from fvslam_graph.sequences.plausibility import camera_of_view

FORMAT = "live"


class LiveCamera:
    """Frames as they come, to be iterated over once; a context manager, which waits for the first.

        with open_live("0", fov=80) as camera:
            estimator = Estimator(camera.sequence.camera)
            for frame in camera:
                result = estimator.step(frame.image, frame.stamp)

    Args:
        source: Read in a thread of its own.
        camera_of: The camera as built, by the size of its first image, (width, height) in pixels.
        ground: What is known of the ground below.
        patience: Seconds after which, without an image, it is at its end.

    Attributes:
        name: Of the source.
        taken: How many frames have been handed on.
        latencies: Seconds from an image's arrival until somebody was ready for the next, one for each frame.
    """

    def __init__(
        self,
        source: LiveSource,
        camera_of: Callable[[tuple[int, int]], Camera],
        ground: Ground | None = None,
        patience: float | None = None,
    ) -> None:
        self.name = source.name
        self._images, self._camera_of, self._ground, self._patience = LatestImage(source), camera_of, ground, patience
        self._depth = DEPTHS[0]
        self.taken, self.latencies = 0, array("d")

    def __enter__(self) -> LiveCamera:
        self._images.__enter__()
        try:
            first = self._images.take(self._patience)
            if first is None:
                raise SequenceError(f"no image has come from {self.name}")
            self._first = first
            height, width = first.levels.shape
            self._camera = self._camera_of((width, height))
        except BaseException:
            self.stop()
            raise
        undistorted = self._camera.undistorted()
        self._rectify = None if self._camera.distortion is Distortion.NONE else Rectifier(self._camera, undistorted)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop()

    def __iter__(self) -> Iterator[Frame]:
        image: LiveImage | None = self._first
        while image is not None:
            height = np.nan if self._ground is None else float(self._ground.heights[0])
            frame = Frame(self.taken, image.stamp, self._usable(image.levels), height)
            self.taken += 1
            yield frame
            self.latencies.append(time.monotonic() - image.arrived)
            image = self._images.take(self._patience)

    @property
    def sequence(self) -> Sequence:
        """What is known of the recording beforehand; it has no frames."""
        camera = self._camera.undistorted()
        return Sequence(self.name, FORMAT, camera, np.empty(0), load=lambda index: None, ground=self._ground)

    @property
    def dropped(self) -> int:
        """How many images nobody was ready for."""
        return self._images.dropped

    def stop(self) -> None:
        """End after the present frame; signal handlers may call it."""
        self._images.stop()

    def summary(self) -> str:
        """Frames, drops and latency, in words."""
        median, most = 1000 * np.quantile(self.latencies or [np.nan], (0.5, 0.95))
        return f"{self.taken} frames, {self.dropped} dropped; latency {median:.0f} ms (median), {most:.0f} ms (95 %)"

    def _usable(self, levels: Levels) -> Image | None:
        """The rectified image; None where it has another size. Images of 16 bits use as many as the brightest did."""
        if levels.shape != (self._camera.height, self._camera.width):
            return None
        if levels.dtype == np.uint16:
            highest = int(levels.max())
            self._depth = next(depth for depth in DEPTHS if depth >= self._depth and highest < 2**depth)
        image = eight_bits(levels, self._depth)
        return image if self._rectify is None else self._rectify(image)


def open_live(
    where: str,
    calibration: str | Path | None = None,
    fov: float | None = None,
    *,
    camera_height: float | None = None,
    camera_pitch: float | None = None,
    patience: float | None = None,
) -> LiveCamera:
    """Open a camera, a stream, or a folder into which images come.

    Args:
        where: Number of a camera, address of a stream, or a folder.
        calibration: Its file; by default `camera.yaml` in the folder.
        fov: Degrees that images are wide, in place of a calibration.
        camera_height: Metres from the camera to the ground.
        camera_pitch: Radians by which the camera looks below the horizon.
        patience: Seconds after which, without an image, it is at its end; by default it waits for ever.

    Raises:
        SequenceError: There is no such source, or a number is out of range.
        CameraError: Nothing is known of the camera.
    """
    if patience is not None and not 0 < patience < TIMEOUT_MAX:
        raise SequenceError(f"the time to wait for an image must be a positive number of seconds, not {patience:g}")
    source = open_source(where)
    beside = Path(where).expanduser() / "camera.yaml"
    if fov is not None:
        camera_of = partial(camera_of_view, fov=fov)
    elif calibration is not None:
        camera_of = partial(_calibrated, Path(calibration).expanduser())
    elif isinstance(source, FolderSource) and beside.exists():
        camera_of = partial(_calibrated, beside)
    else:
        raise CameraError(f"nothing is known of the camera of {where}: give its calibration, or its field of view")
    return LiveCamera(source, camera_of, given_ground(source.name, None, 1, camera_height, camera_pitch), patience)


def _calibrated(file: Path, size: tuple[int, int]) -> Camera:
    camera = read_calibration(file).camera
    if (camera.width, camera.height) != size:
        raise CameraError(f"images are {size[0]}x{size[1]} pixels, but {file} is for {camera.width}x{camera.height}")
    return camera
