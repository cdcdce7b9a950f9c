"""A camera from views of a calibration board (Zhang 2000, by OpenCV), with standard deviations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Distortion
from fvslam_graph.core.errors import CameraError
from fvslam_graph.sequences.boards import BoardView
from fvslam_graph.sequences.camera_file import PARAMETERS
from fvslam_graph.sequences.plausibility import make_camera

MIN_VIEWS, MAX_VIEWS = 8, 40
MIN_DIFFERENCE = 0.03  # of the image's width that some corner of the board is elsewhere in another view
MAX_FOCAL_SIGMA = 0.01  # of the focal length; more says that the board was hardly tilted
MAX_VIEW_ERROR = 3.0  # times the median error, from which on a view is left out: it is blurred, or the board was bent


@dataclass(frozen=True)
class BoardCalibration:
    """A calibrated camera.

    Attributes:
        camera: With distortion k1 k2 p1 p2.
        sigmas: (8,) standard deviations of PARAMETERS, by the residuals.
        views: Those that it is by.
        residuals: (N, 2) pixels of each view, seen less projected.
    """

    camera: Camera
    sigmas: NDArray[np.float64]
    views: tuple[BoardView, ...]
    residuals: tuple[NDArray[np.float64], ...]

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, pixels."""
        return float(np.sqrt(np.mean(np.concatenate(self.residuals) ** 2) * 2))

    @property
    def origin(self) -> str:
        """What it is by."""
        return f"{len(self.views)} views of a board, {self.rms:.3f} pixels root mean square"


def calibrate(path: Path, views: list[BoardView], size: tuple[int, int]) -> BoardCalibration:
    """The camera that explains the views best.

    Args:
        path: Of the images, for messages.
        views: As many as there are; those that are spread best are used.
        size: Width, height of the images, pixels.

    Raises:
        CameraError: There are too few views, or they are too much alike.
    """
    chosen = _spread(views, size)
    if len(chosen) < MIN_VIEWS:
        raise CameraError(
            f"{path} shows the board in {len(chosen)} different views, {MIN_VIEWS} are needed: "
            "move it to all parts of the image, and tilt it to all sides"
        )
    calibration = _fit(path, chosen, size)
    errors = np.array([np.sqrt(np.mean(residual**2)) for residual in calibration.residuals])
    good = errors < MAX_VIEW_ERROR * np.median(errors)
    if MIN_VIEWS <= good.sum() < len(chosen):
        calibration = _fit(path, [view for view, kept in zip(chosen, good, strict=True) if kept], size)
    camera, sigma = calibration.camera, calibration.sigmas[0]
    if not sigma < MAX_FOCAL_SIGMA * camera.fx:
        raise CameraError(
            f"{path}: the views are too much alike to tell the focal length, {camera.fx:.0f} +- {sigma:.0f} pixels: "
            "tilt the board by 30 degrees and more to all sides"
        )
    make_camera(path, size, (camera.fx, camera.fy, camera.cx, camera.cy), camera.distortion, camera.coefficients)
    return calibration


def _fit(path: Path, views: list[BoardView], size: tuple[int, int]) -> BoardCalibration:
    """Least squares over the camera and all poses of the board.

    The covariance is not OpenCV's: where the views leave a direction open, that one is far too small.
    """
    try:
        _, matrix, lens, rotations, translations = cv2.calibrateCamera(
            [view.points for view in views], [view.pixels for view in views], size, None, None, flags=cv2.CALIB_FIX_K3
        )
    except cv2.error:
        raise CameraError(f"{path}: no camera explains the views of the board; is it flat, and of this size?") from None
    lens = np.ravel(lens)[:4]
    residuals = []
    information = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    for view, rotation, translation in zip(views, rotations, translations, strict=True):
        pixels, jacobian = cv2.projectPoints(view.points, rotation, translation, matrix, lens)
        residuals.append(view.pixels - pixels.reshape(-1, 2))
        J_pose, J_camera = jacobian[:, :6], jacobian[:, 6:]
        own = J_camera - J_pose @ np.linalg.lstsq(J_pose, J_camera)[0]  # what the pose cannot take up
        information += own.T @ own
    squares = np.concatenate(residuals) ** 2
    variance = squares.sum() / (squares.size - 6 * len(views) - len(PARAMETERS))
    sigmas = np.sqrt(variance * np.diag(np.linalg.pinv(information, hermitian=True, rcond=0)))
    fx, fy, cx, cy = (float(value) for value in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]))
    camera = Camera(*size, fx, fy, cx, cy, Distortion.RADTAN, tuple(map(float, lens)))
    return BoardCalibration(camera, sigmas, tuple(views), tuple(residuals))


def _spread(views: list[BoardView], size: tuple[int, int]) -> list[BoardView]:
    """The views that differ most from each other, by where they have the outer corners of the board."""
    outer = np.array([_outer_corners(view) for view in views]) / size[0]
    chosen = [0]
    distance = np.full(len(views), np.inf)
    while len(chosen) < MAX_VIEWS:
        distance = np.minimum(distance, np.linalg.norm(outer - outer[chosen[-1]], axis=2).max(axis=1))
        if distance.max() < MIN_DIFFERENCE:
            break
        chosen.append(int(np.argmax(distance)))
    return [views[index] for index in sorted(chosen)]


def _outer_corners(view: BoardView) -> NDArray[np.float64]:
    """Where the corners of a rectangle about the points that are seen lie in the image, (4, 2), pixels."""
    flat = view.points[:, :2]
    (left, top), (right, bottom) = flat.min(axis=0), flat.max(axis=0)
    homography, _ = cv2.findHomography(flat, view.pixels)
    if homography is None:
        return np.tile(view.pixels.mean(axis=0), (4, 1)).astype(float)
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]], np.float64)
    return np.asarray(cv2.perspectiveTransform(corners[:, None], homography).reshape(4, 2), float)
