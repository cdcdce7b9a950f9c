"""Recordings as the estimators see them, whatever their format."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Image, Recalibration
from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sensors import Fix, SensorSeries
from fvslam_graph.core.trajectory import Trajectory

FIRST_FIX = 1e-3  # seconds before the first frame at which a fix is still of it
QUATERNION_ERROR = 0.01  # of the length of a quaternion as it is written
MOUNTING_SIGMA = 0.02  # of the logarithm of a height that was measured once: by tape, with another load
MAX_RECALIBRATION = 0.1  # of the width that pixels are moved; more is no rest that a calibration has left


@dataclass(frozen=True)
class Frame:
    """One image in time.

    Attributes:
        index: Position in the sequence, from 0.
        stamp: Seconds.
        image: (H, W) uint8, rectified; None where no usable image could be read.
        height: Metres from the camera to the ground plane below it; NaN where unknown.
        height_sigma: Its standard deviation, metres.
        fixes: Positions that a GNSS receiver has measured since the frame before.
        gravity: (3,) direction of gravity in the camera, down; None where it is not measured.
    """

    index: int
    stamp: float
    image: Image | None
    height: float = float("nan")
    height_sigma: float = 0.0
    fixes: tuple[Fix, ...] = ()
    gravity: NDArray[np.float64] | None = None


class DuplicateFilter:
    """Takes out images that are repeated: a byte-identical one is a duplicate, not a camera that stands.

    A driver that has no new image delivers the last one again; of the camera it says nothing. Images without any
    contrast, as in the dark, may well be the same.
    """

    def __init__(self) -> None:
        self._last: Image | None = None

    def filtered(self, frame: Frame) -> Frame:
        """The frame, without its image where that is the last one again."""
        if frame.image is None:
            return frame
        if self._last is not None and np.array_equal(frame.image, self._last) and np.ptp(frame.image) > 0:
            return replace(frame, image=None)
        self._last = frame.image
        return frame


@dataclass(frozen=True)
class Ground:
    """The ground below the camera: the fact that makes one camera metric.

    Attributes:
        heights: (N,) metres from the camera to the ground plane, per frame; NaN where unknown. For an `Estimator`, the
            last one holds from there on.
        normal: (3,) unit vector in camera coordinates that points from the camera down to the ground plane.
        normal_sigma: Standard deviation of its direction, radians; how far the camera tilts against the ground.
        source: Where the heights come from, for the reader of a report.
        height_sigma: Standard deviation of the heights, metres, of an error that each has for itself,
        common_sigma: and of their logarithms, of one that all have in common.
    """

    heights: NDArray[np.float64]
    normal: NDArray[np.float64]
    normal_sigma: float
    source: str
    height_sigma: float = 0.0
    common_sigma: float = 0.0

    @staticmethod
    def below(height: float = math.nan, pitch: float = 0.0, tilt: float = 0.05) -> Ground:
        """Level ground.

        Args:
            height: Metres from the camera down to it; NaN where each frame comes with its own.
            pitch: Radians that the camera looks below the horizon.
            tilt: Standard deviation of its attitude, radians.
        """
        normal = np.array([0.0, math.cos(pitch), math.sin(pitch)])
        common_sigma = 0.0 if math.isnan(height) else MOUNTING_SIGMA
        return Ground(np.array([height]), normal, tilt, "given", common_sigma=common_sigma)


@dataclass(frozen=True)
class Sequence:
    """A recording: lazily read, rectified images of one camera with what is known about them.

    Attributes:
        name: For tables and plots.
        format: The format's name, e.g. "kitti-odometry".
        camera: The camera of the rectified images.
        stamps: (N,) seconds.
        load: Reads image i, 0 <= i < N, as (H, W) uint8 of the camera's size; None where it cannot be decoded.
        ground_truth: world_T_camera of this camera; its stamps need not be those of the images.
        ground: What is known about the ground plane.
        sensors: Readings of other sensors, over the whole recording.
        gnss: Those fixes of a receiver that estimators are to use, with their deviations; see `with_gnss`.
        start: world_T_camera of the first image, where the user knows it; see `starting_at`.
        notes: Gaps and oddities found on opening, one sentence each.
        source: What `open_sequence` takes to open it again; None where that is not known.
    """

    name: str
    format: str
    camera: Camera
    stamps: NDArray[np.float64]
    load: Callable[[int], Image | None]
    ground_truth: Trajectory | None = None
    ground: Ground | None = None
    sensors: tuple[SensorSeries, ...] = ()
    gnss: SensorSeries | None = None
    start: gtsam.Pose3 | None = None
    notes: tuple[str, ...] = ()
    source: dict[str, Any] | None = None

    def __len__(self) -> int:
        return len(self.stamps)

    def __repr__(self) -> str:
        size = f"{self.camera.width}x{self.camera.height} pixels"
        return f"Sequence({self.name!r}, {self.format}, {len(self)} frames, {size})"

    def __iter__(self) -> Iterator[Frame]:
        for index in range(len(self)):
            yield self.frame(index)

    def frame(self, index: int) -> Frame:
        """Frame `index`; an image of another size than the camera's counts as unreadable."""
        image = self.load(index)
        if image is not None and image.shape != (self.camera.height, self.camera.width):
            image = None
        stamp = float(self.stamps[index])
        fixes = self._fixes(stamp - FIRST_FIX if index == 0 else float(self.stamps[index - 1]), stamp)
        if self.ground is None:
            return Frame(index, stamp, image, fixes=fixes)
        return Frame(index, stamp, image, float(self.ground.heights[index]), self.ground.height_sigma, fixes)

    def with_gnss(self, fixes: SensorSeries, sigma: float | None = None) -> Sequence:
        """The sequence with fixes that its estimator uses.

        Args:
            fixes: Of kind GNSS.
            sigma: Standard deviation along each axis, metres, in place of those of the series.

        Raises:
            SequenceError: The deviation is not given, or no positive number.
        """
        sigmas = fixes.sigmas if sigma is None else np.full_like(fixes.sigmas, sigma)
        if not ((sigmas > 0) & (sigmas < np.inf)).all():  # also where it is not a number
            raise SequenceError(
                f"{fixes.source}: the standard deviation of a position must be a positive number of metres; "
                "give it by --gnss-sigma"
            )
        return replace(self, gnss=replace(fixes, sigmas=sigmas))

    def starting_at(self, pose: Iterable[float]) -> Sequence:
        """The sequence in a world in which its first image is taken there, instead of that of the first camera.

        Args:
            pose: tx, ty, tz (m), qx, qy, qz, qw, as in TUM's files.

        Raises:
            SequenceError: These are no seven such numbers.
        """
        numbers = np.array(tuple(pose), float)
        length = np.linalg.norm(numbers[3:])
        if len(numbers) != 7 or not np.isfinite(numbers).all() or abs(length - 1) > QUATERNION_ERROR:
            raise SequenceError("the start is a position (m) and a quaternion of length 1: tx ty tz qx qy qz qw")
        qx, qy, qz, qw = numbers[3:] / length
        return replace(self, start=gtsam.Pose3(gtsam.Rot3.Quaternion(qw, qx, qy, qz), numbers[:3]))

    def _fixes(self, begin: float, end: float) -> tuple[Fix, ...]:
        """The fixes after `begin`, up to `end`, seconds."""
        if self.gnss is None:
            return ()
        first, last = np.searchsorted(self.gnss.stamps, (begin, end), side="right")
        rows = zip(self.gnss.stamps, self.gnss.values, self.gnss.sigmas[:, [1, 0, 2]], strict=True)
        return tuple(Fix(float(stamp), *row) for stamp, *row in islice(rows, int(first), int(last)))

    def select(self, start: int | None = None, stop: int | None = None, stride: int = 1) -> Sequence:
        """The frames start, start + stride, ... before stop, as a sequence of its own."""
        if stride < 1:
            raise SequenceError(f"the stride must be at least 1, not {stride}")
        kept = range(len(self))[start:stop:stride]
        if not kept:
            raise SequenceError(f"no frame of {self.name} is in {start}:{stop}, it has {len(self)}")
        chosen = np.array(kept)
        ground = self.ground and replace(self.ground, heights=self.ground.heights[chosen])
        load = self.load
        return replace(self, stamps=self.stamps[chosen], load=lambda i: load(kept[i]), ground=ground, source=None)

    def scaled(self, factor: float) -> Sequence:
        """The same recording with images resized by `factor` (0 < factor <= 1)."""
        camera = self.camera.scaled(factor)
        load = self.load

        def resized(index: int) -> Image | None:
            image = load(index)
            if image is None:
                return None
            small: Image = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
            return small

        return replace(self, camera=camera, load=resized, source=None)

    def recalibrated(self, camera: Camera) -> Sequence:
        """The same recording where its images, as its calibration undistorts them, are really of another camera.

        Raises:
            SequenceError: It is of images of another size, or differs by so much that it is no rest of a calibration.
        """
        width, height = size = self.camera.width, self.camera.height
        if (camera.width, camera.height) != size:
            raise SequenceError(
                f"the calibration is of {camera.width}x{camera.height} images, but {self.name} has {width}x{height}"
            )
        rim = np.array([(x, y) for x in (0, width / 2, width - 1) for y in (0, height / 2, height - 1)])
        moved = np.linalg.norm(self.camera.project(camera.rays(rim)) - rim, axis=1).max()
        if not moved <= MAX_RECALIBRATION * width:
            raise SequenceError(
                f"the calibration moves pixels of {self.name} by up to {moved:.0f}: it should be that of the images as "
                "they are once undistorted, and not of the images as they are in their files"
            )
        load, recalibration = self.load, Recalibration(self.camera, camera)

        def rectified(index: int) -> Image | None:
            image = load(index)
            return None if image is None or image.shape != (height, width) else recalibration(image)

        note = f"pixels are moved by up to {moved:.1f}, by another calibration"
        return replace(self, load=rectified, notes=(*self.notes, note), source=None)
