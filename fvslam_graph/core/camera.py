"""The pinhole camera, its lens distortion and the rectification that removes it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import CameraError

Image = NDArray[np.uint8]


class Distortion(StrEnum):
    """Lens models, named as in the ASL/EuRoC calibration files."""

    NONE = "none"
    RADTAN = "radtan"  # k1 k2 p1 p2 [k3], Brown 1966, as OpenCV's main model
    RATIONAL = "rational"  # k1 k2 p1 p2 k3 k4 k5 k6, the same over a polynomial of k4 k5 k6, as OpenCV's rational model
    EQUIDISTANT = "equidistant"  # k1 k2 k3 k4, Kannala and Brandt 2006, as OpenCV's fisheye model


_UNDISTORTION_CRITERIA = (
    cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS,
    100,
    1e-12,
)  # of undistortion, which is iterative
_COEFFICIENT_COUNTS = {
    Distortion.NONE: (0,),
    Distortion.RADTAN: (4, 5),
    Distortion.RATIONAL: (8,),
    Distortion.EQUIDISTANT: (4,),
}

MIN_SIDE, MAX_SIDE = 16, 10_000  # pixels; the larger keeps the maps of a rectification below a gigabyte


@dataclass(frozen=True)
class Camera:
    """A calibrated camera with axes x right, y down, z forward.

    Attributes:
        width, height: Image size in pixels.
        fx, fy, cx, cy: Focal lengths and principal point in pixels; the centre of the first pixel is (0, 0).
        distortion: Lens model.
        coefficients: Its coefficients, dimensionless, in OpenCV's order.

    Raises:
        CameraError: A number is not finite, a side is not of 16 to 10,000 pixels, a focal length is not positive, or
            the count of coefficients does not fit the model.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion = Distortion.NONE
    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.coefficients)
        if not np.all(np.isfinite(numbers)):
            raise CameraError(f"the calibration has a number that is not finite: {numbers}")
        if not all(MIN_SIDE <= side <= MAX_SIDE for side in (self.width, self.height)):
            raise CameraError(
                f"the image size must be {MIN_SIDE} to {MAX_SIDE} pixels a side, not {self.width}x{self.height}"
            )
        if self.fx <= 0 or self.fy <= 0:
            raise CameraError(f"the focal lengths must be positive, not fx={self.fx:g}, fy={self.fy:g}")
        if len(self.coefficients) not in _COEFFICIENT_COUNTS[self.distortion]:
            raise CameraError(
                f"distortion '{self.distortion}' takes {' or '.join(map(str, _COEFFICIENT_COUNTS[self.distortion]))} "
                f"coefficients, not {len(self.coefficients)}"
            )

    @cached_property
    def K(self) -> NDArray[np.float64]:
        """The calibration matrix, (3, 3), pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels (N, 2) of points (N, 3) in camera coordinates, metres; NaN for points not in front of the camera."""
        points = np.asarray(points, float).reshape(-1, 3)
        pixels = np.full((len(points), 2), np.nan)
        front = points[:, 2] > 0
        if np.any(front):
            pixels[front] = self._distort(points[front] / points[front, 2:])
        return pixels

    def normalize(self, pixels: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Undistorted image coordinates (N, 2) at unit depth (x/z, y/z) of pixels (N, 2)."""
        pixels = np.asarray(pixels, float).reshape(-1, 2)
        if self.distortion is Distortion.NONE or not len(pixels):
            return np.asarray((pixels - (self.cx, self.cy)) / (self.fx, self.fy), float)
        undistort = cv2.fisheye.undistortPoints if self.distortion is Distortion.EQUIDISTANT else cv2.undistortPoints
        normalized = undistort(pixels[:, None], self.K, np.array(self.coefficients), criteria=_UNDISTORTION_CRITERIA)
        return np.asarray(normalized, float).reshape(-1, 2)

    def rays(self, pixels: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Viewing rays (N, 3) of pixels (N, 2), with z = 1."""
        rays = np.ones((len(pixels), 3))
        rays[:, :2] = self.normalize(pixels)
        return rays

    def contains(self, pixels: NDArray[np.float64], border: float = 0.0) -> NDArray[np.bool_]:
        """Which pixels (N, 2) lie in the image, `border` pixels off its rim; NaN does not."""
        low, high = border, (self.width - 1 - border, self.height - 1 - border)
        inside: NDArray[np.bool_] = np.all((pixels >= low) & (pixels <= high), axis=1)
        return inside

    def scaled(self, factor: float) -> Camera:
        """The camera of the same images, resized by `factor` (> 0) to whole pixels, with pixel areas averaged."""
        width, height = round(self.width * factor), round(self.height * factor)
        across, down = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * across,
            fy=self.fy * down,
            cx=(self.cx + 0.5) * across - 0.5,  # pixel centres, not corners, are at whole numbers
            cy=(self.cy + 0.5) * down - 0.5,
        )

    def corrected(self, correction: NDArray[np.float64]) -> Camera:
        """The camera of images that were undistorted by a calibration that is wrong.

        Args:
            correction: (7,) what is to be added to the logarithm of its focal length, and what is left of OpenCV's k1
                and k2, by how many focal lengths the principal point is off to the right and down, and p1 and p2.
        """
        log_focal, k1, k2, right, down, p1, p2 = map(float, correction)
        stretch = math.exp(log_focal)
        return replace(
            self,
            fx=self.fx * stretch,
            fy=self.fy * stretch,
            cx=self.cx + right * self.fx,
            cy=self.cy + down * self.fy,
            distortion=Distortion.RADTAN,
            coefficients=(k1, k2, p1, p2),
        )

    def undistorted(self) -> Camera:
        """The distortion-free camera with the same calibration matrix and size."""
        return replace(self, distortion=Distortion.NONE, coefficients=())

    def _distort(self, rays: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.distortion is Distortion.NONE:
            return np.asarray(rays[:, :2] * (self.fx, self.fy) + (self.cx, self.cy), float)
        zero = np.zeros(3)
        if self.distortion is Distortion.EQUIDISTANT:
            pixels, _ = cv2.fisheye.projectPoints(rays[:, None], zero, zero, self.K, np.array(self.coefficients))
        else:
            pixels, _ = cv2.projectPoints(rays, zero, zero, self.K, np.array(self.coefficients))
        return np.asarray(pixels, float).reshape(-1, 2)


def by_calibration(rays: NDArray[np.float64], gradient: NDArray[np.float64]) -> NDArray[np.float64]:
    """How numbers change with the calibration, (N, 2): with the logarithm of the focal length and with k1.

    The ray of a pixel that was undistorted by a wrong calibration, see `Camera.corrected`, is nearer the optical axis
    by as much as the focal length is longer, and by k1 times the square of its distance from it.

    Args:
        rays: (N, 2) or more, z = 1.
        gradient: (N, 2) of the numbers, in x and y of these rays; or (2,), if it is the same for all.
    """
    nearer = -np.vecdot(rays[:, :2], gradient)
    return np.stack([nearer, np.vecdot(rays[:, :2], rays[:, :2]) * nearer], axis=1)


class Rectifier:
    """Removes lens distortion, and optionally rotates the camera; the maps are computed once.

    Args:
        source: The camera as built, with distortion.
        target: The ideal camera that the rectified images shall have.
        rotation: target_R_source, (3, 3); KITTI's R_rect. Identity where not given.
    """

    def __init__(self, source: Camera, target: Camera, rotation: NDArray[np.float64] | None = None) -> None:
        rotation = np.eye(3) if rotation is None else rotation
        size = (target.width, target.height)
        make = (
            cv2.fisheye.initUndistortRectifyMap
            if source.distortion is Distortion.EQUIDISTANT
            else (cv2.initUndistortRectifyMap)
        )
        coefficients = np.array(source.coefficients or (0.0,) * 4)
        self.maps = make(source.K, coefficients, rotation, target.K, size, cv2.CV_16SC2)
        self.source = source

    def __call__(self, image: Image) -> Image:
        """The rectified image; `image` has the size of the source camera."""
        rectified: Image = cv2.remap(image, *self.maps, cv2.INTER_LINEAR)
        return rectified


class Recalibration:
    """Images that were undistorted by a calibration which is wrong are rectified again.

    Args:
        camera: Undistorted, as it was taken to be; the images are those of such a camera afterwards.
        true: The camera that they really are of, of the same size.
    """

    def __init__(self, camera: Camera, true: Camera) -> None:
        self._camera, self._true = camera, true
        self._rectifier = Rectifier(true, camera)

    def __call__(self, image: Image) -> Image:
        """The image rectified again."""
        return self._rectifier(image)

    def corrected(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where pixels (N, 2) of the image are after that."""
        return self._camera.project(self._true.rays(pixels))

    def filed(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where pixels (N, 2) of the corrected image are in the image as it was."""
        return self._true.project(self._camera.rays(pixels))
