"""Numbers of a calibration made into a camera or a pose, if they can be those of one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Distortion
from fvslam_graph.core.errors import CameraError
from fvslam_graph.core.trajectory import pose_from_matrix

Array = NDArray[np.float64]

MODELS = {
    "none": Distortion.NONE,
    "radtan": Distortion.RADTAN,
    "radial-tangential": Distortion.RADTAN,  # EuRoC
    "plumb_bob": Distortion.RADTAN,  # ROS
    "rational_polynomial": Distortion.RATIONAL,  # ROS
    "equidistant": Distortion.EQUIDISTANT,
    "fisheye": Distortion.EQUIDISTANT,
}

MIN_VIEW, MAX_VIEW = 5.0, 175.0  # degrees from side to side, as a pinhole; outside, f is in other units than pixels
MAX_ASPECT = 3.0  # of the focal lengths
MAX_SKEW = 1e-3  # of the focal length: a quarter of a pixel in the corners
MAX_TANGENTIAL = 0.03  # of p1 and p2; ten times what lenses have
MAX_FOCAL_RATIO = 1.2  # ratio of the focal lengths from which on a note says so
MAX_ASIDE = 0.15  # of the image's size, principal point off the middle; more, unless images are cut, is a mistake
FOLDED = 1.0  # pixels


def make_camera(
    path: Path,
    size: Sequence[float],
    intrinsics: Sequence[float],
    model: str,
    coefficients: Sequence[float] | None,
) -> Camera:
    """A camera whose errors name the file it comes from.

    Args:
        path: That file.
        size: Width, height, pixels.
        intrinsics: fx, fy, cx, cy, pixels.
        model: Name of the distortion model, as this package, EuRoC, ROS or OpenCV spell it; "" where none is named.
        coefficients: Its coefficients; None where there are none.

    Raises:
        CameraError: An unknown model, coefficients that do not fit it, or numbers that make no camera.
    """
    try:
        distortion, coefficients = _distortion(model, coefficients)
        if any(side != int(side) for side in size):
            raise CameraError(f"the image size must be whole pixels, not {size[0]:g}x{size[1]:g}")
        fx, fy, cx, cy = map(float, intrinsics)
        camera = Camera(int(size[0]), int(size[1]), fx, fy, cx, cy, distortion, tuple(map(float, coefficients)))
        _require_plausible(camera)
    except CameraError as error:
        raise CameraError(f"{path}: {error}") from None
    return camera


def camera_of_view(size: Sequence[int], fov: float) -> Camera:
    """A camera without distortion whose images of `size` (width, height) are `fov` degrees wide; raises CameraError."""
    if not MIN_VIEW <= fov <= MAX_VIEW:
        raise CameraError(
            f"the field of view must be {MIN_VIEW:g} to {MAX_VIEW:g} degrees from side to side, not {fov:g}"
        )
    width, height = size
    focal = width / 2 / math.tan(math.radians(fov) / 2)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def _distortion(model: str, given: Sequence[float] | None) -> tuple[Distortion, Sequence[float]]:
    """The model and as many coefficients as it has; OpenCV's lists of 4, 5, 8, 12 or 14 are one family."""
    if model and model.lower() not in MODELS:
        raise CameraError(f"the distortion model '{model}' is not one of {', '.join(MODELS)}")
    coefficients = list(given or ())
    distortion = MODELS[model.lower()] if model else Distortion.RADTAN if coefficients else Distortion.NONE
    if not coefficients and distortion is not Distortion.NONE:
        raise CameraError(f"the distortion model '{model}' has no coefficients; give them, or the model none")
    if distortion is Distortion.EQUIDISTANT:
        return distortion, _without_zeros(coefficients, 4)
    if not any(coefficients):
        return Distortion.NONE, ()
    if distortion is Distortion.NONE:
        return distortion, coefficients
    short = _without_zeros(coefficients, 5)
    if len(short) <= 5:
        return Distortion.RADTAN, short
    if len(coefficients) < 8:
        return Distortion.RADTAN, coefficients  # which has another number of them
    return Distortion.RATIONAL, _without_zeros(coefficients, 8)


def _without_zeros(coefficients: list[float], count: int) -> list[float]:
    """The first `count` of the coefficients, if the others are zero."""
    return coefficients if any(coefficients[count:]) else coefficients[:count]


def _require_plausible(camera: Camera) -> None:
    view = 2 * np.degrees(np.arctan(camera.width / 2 / camera.fx))
    if not MIN_VIEW <= view <= MAX_VIEW:
        raise CameraError(
            f"a focal length of {camera.fx:g} pixels makes images {view:.3g} degrees wide: is it in pixels?"
        )
    if not 1 / MAX_ASPECT <= camera.fx / camera.fy <= MAX_ASPECT:
        raise CameraError(f"the focal lengths should be nearly the same, not fx={camera.fx:g}, fy={camera.fy:g}")
    if not (0 < camera.cx < camera.width - 1 and 0 < camera.cy < camera.height - 1):
        raise CameraError(
            f"the principal point ({camera.cx:g}, {camera.cy:g}) is not inside the image of "
            f"{camera.width}x{camera.height} pixels"
        )


def doubts(camera: Camera) -> tuple[str, ...]:
    """Notes on a camera that may be that of other images, or have its numbers in another order."""
    notes = []
    aside = camera.cx / (camera.width - 1) - 0.5, camera.cy / (camera.height - 1) - 0.5
    if max(map(abs, aside)) > MAX_ASIDE:
        notes.append(
            f"the principal point ({camera.cx:g}, {camera.cy:g}) is far from the middle of the "
            f"{camera.width}x{camera.height} pixels: is the calibration that of these images?"
        )
    if not 1 / MAX_FOCAL_RATIO <= camera.fx / camera.fy <= MAX_FOCAL_RATIO:
        notes.append(f"the focal lengths differ much, fx={camera.fx:g}, fy={camera.fy:g}: is their order fx fy cx cy?")
    return tuple(notes)


def pinhole(path: Path, key: str, matrix: Array) -> tuple[float, float, float, float]:
    """Focal lengths and principal point of a camera matrix (3, 3) or projection matrix (3, 4), pixels.

    Raises:
        CameraError: It is transposed, normalised or skewed.
    """
    if np.any(matrix[2, :3] != (0, 0, 1)) or matrix[1, 0] != 0:
        rows = "; ".join(" ".join(f"{value:g}" for value in row[:3]) for row in matrix)
        raise CameraError(f"{path}: the rows of '{key}' should be fx 0 cx; 0 fy cy; 0 0 1, not {rows}")
    if abs(matrix[0, 1]) > MAX_SKEW * abs(matrix[0, 0]):
        raise CameraError(f"{path}: '{key}' has a skew of {matrix[0, 1]:g}, cameras with skew are not supported")
    return matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]


def rigid_pose(path: Path, key: str, matrix: Array) -> gtsam.Pose3:
    """The pose of a matrix (3, 4) or (4, 4) whose rotation may be rounded; raises CameraError where it is no pose."""
    rotation = require_rotation(path, key, matrix[:, :3][:3])
    if len(matrix) == 4 and np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-6:
        raise CameraError(f"{path}: the last row of '{key}' should be 0 0 0 1")
    return pose_from_matrix(np.column_stack([rotation, matrix[:3, 3]]))


def require_rotation(path: Path, key: str, matrix: Array) -> Array:
    """The matrix (3, 3), if it is a rotation but for rounding; raises CameraError."""
    bounded = np.abs(matrix).max() < 2  # of larger numbers, products may overflow
    if not bounded or np.abs(matrix @ matrix.T - np.eye(3)).max() > 0.01 or np.linalg.det(matrix) < 0:
        raise CameraError(
            f"{path}: the rotation of '{key}' is none: its rows should be of length 1 and at right angles"
        )
    return matrix


def distorts_oddly(camera: Camera) -> bool:
    """Whether lenses do not distort like that: folded over within the image, or tangentially as much as radially."""
    if camera.distortion not in (Distortion.RADTAN, Distortion.RATIONAL):
        return False  # beyond a right angle, a fisheye's rays are not points at unit depth
    if np.abs(camera.coefficients[2:4]).max() > MAX_TANGENTIAL:
        return True
    right, bottom = camera.width - 1, camera.height - 1
    pixels = np.array([[0, camera.cy], [right, camera.cy], [camera.cx, 0], [camera.cx, bottom]])
    back = camera.project(camera.rays(pixels))
    return not np.abs(back - pixels).max() < FOLDED
