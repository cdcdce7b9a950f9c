"""Calibration boards and where they are seen in images."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Image
from fvslam_graph.core.errors import CameraError
from fvslam_graph.sequences.files import image_files
from fvslam_graph.sequences.images import ImageFiles, decode, eight_bits
from fvslam_graph.sequences.video import Video
from fvslam_graph.sequences.video import matches as is_video

MIN_CORNERS = 12  # that a view is of; of a ChArUco board, a part may be seen
MAX_WINDOW = 10  # pixels on each side of a corner that its edges are looked at
_BOARD_SEARCH = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
_REFINED = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-3)
MAX_IMAGES = 300  # of a video that are searched, evenly spaced
# ChArUco boards carry markers of one of these; smaller dictionaries are the first markers of larger ones.
_DICTIONARIES = (
    cv2.aruco.DICT_4X4_1000,
    cv2.aruco.DICT_5X5_1000,
    cv2.aruco.DICT_6X6_1000,
    cv2.aruco.DICT_7X7_1000,
    cv2.aruco.DICT_ARUCO_ORIGINAL,
    cv2.aruco.DICT_APRILTAG_36H11,
)


@dataclass(frozen=True)
class BoardView:
    """A board in an image.

    Attributes:
        name: Of the image.
        points: (N, 3) corners on the board, metres, z = 0.
        pixels: (N, 2) where they are seen.
    """

    name: str
    points: NDArray[np.float32]
    pixels: NDArray[np.float32]


@dataclass(frozen=True)
class Board:
    """A flat board.

    Attributes:
        description: For messages.
        corners: (N, 3) metres, z = 0.
        find: The indices (M,) of the corners that an image shows, and their pixels (M, 2).
    """

    description: str
    corners: NDArray[np.float32]
    find: Callable[[Image], tuple[NDArray[np.int_], NDArray[np.float32]]]

    def view(self, name: str, image: Image) -> BoardView | None:
        """The board as an image (H, W) shows it; None where it does not, or too little of it."""
        indices, pixels = self.find(image)
        return None if len(indices) < MIN_CORNERS else BoardView(name, self.corners[indices], pixels)


def checkerboard(size: str, square: float) -> Board:
    """A checkerboard.

    Args:
        size: Inner corners, `9x6`.
        square: Length of a side, metres.

    Raises:
        CameraError: They cannot be that.
    """
    columns, rows = _size(size, square)

    def find(image: Image) -> tuple[NDArray[np.int_], NDArray[np.float32]]:
        found, pixels = cv2.findChessboardCorners(image, (columns, rows), None, _BOARD_SEARCH)
        if not found:
            return np.empty(0, int), np.empty((0, 2), np.float32)
        grid = pixels.reshape(rows, columns, 2)
        spacing = min(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1))
        window = int(np.clip(spacing / 4, 2, MAX_WINDOW))
        refined = cv2.cornerSubPix(image, pixels.reshape(-1, 1, 2).copy(), (window, window), (-1, -1), _REFINED)
        return np.arange(columns * rows), refined.reshape(-1, 2)

    across, down = np.meshgrid(np.arange(columns), np.arange(rows))
    corners = square * np.column_stack([across.ravel(), down.ravel(), np.zeros(columns * rows)])
    return Board(f"a checkerboard of {columns}x{rows} inner corners", corners.astype(np.float32), find)


def charuco(size: str, square: float, marker: float) -> Board:
    """A ChArUco board; its dictionary of markers is found out.

    Args:
        size: Squares, `7x5`.
        square: Length of a side, metres.
        marker: Length of a side of the markers, metres.

    Raises:
        CameraError: They cannot be that.
    """
    columns, rows = _size(size, square)
    if not 0 < marker < square:
        raise CameraError(f"the markers should be smaller than the squares of {square:g} m, not {marker:g} m")
    dictionaries = [cv2.aruco.getPredefinedDictionary(kind) for kind in _DICTIONARIES]
    boards = [cv2.aruco_CharucoBoard((columns, rows), square, marker, dictionary) for dictionary in dictionaries]
    detectors = [cv2.aruco_CharucoDetector(board) for board in boards]

    def find(image: Image) -> tuple[NDArray[np.int_], NDArray[np.float32]]:
        for detector in tuple(detectors):
            pixels, ids, _, _ = detector.detectBoard(image)
            if ids is not None and len(ids) >= MIN_CORNERS:
                detectors[:] = [detector]  # all images show the same board
                return ids.ravel(), pixels.reshape(-1, 2)
        return np.empty(0, int), np.empty((0, 2), np.float32)

    corners = np.array(boards[0].getChessboardCorners(), np.float32)
    return Board(f"a ChArUco board of {columns}x{rows} squares", corners, find)


def find_board(path: Path, board: Board) -> tuple[list[BoardView], tuple[int, int]]:
    """The views of a board in a folder of images or a video, and (width, height) of the images, pixels.

    Raises:
        FvslamError: There are no images, or none shows the board.
    """
    if is_video(path):
        video = Video(path)
        chosen = np.unique(np.linspace(0, len(video.stamps) - 1, MAX_IMAGES).round().astype(int))
        size = video.size
        images: Iterator[tuple[str, Image | None]] = ((f"frame {n}", video.frame(int(n))) for n in chosen)
        count = len(chosen)
    elif path.is_dir():
        folder = path / "images" if (path / "images").is_dir() else path
        paths = image_files(folder)
        if not paths:
            raise CameraError(f"{folder} holds no images")
        files = ImageFiles(paths)
        size, count = files.size, len(paths)
        images = (
            (file.name, None if (levels := decode(file)) is None else eight_bits(levels, files.depth)) for file in paths
        )
    else:
        raise CameraError(f"{path} is no folder of images and no video")
    seen = (board.view(name, image) for name, image in images if image is not None and image.shape == size[::-1])
    views = [view for view in seen if view is not None]
    if not views:
        raise CameraError(f"none of the {count} images of {path} shows {board.description}")
    return views, size


def _size(text: str, square: float) -> tuple[int, int]:
    if not (match := re.fullmatch(r"(\d{1,2})x(\d{1,2})", text)) or min(map(int, match.groups())) < 3:
        raise CameraError(f"the size of a board is written COLUMNSxROWS, as in 9x6, each at least 3, not '{text}'")
    if not 0 < square < np.inf:
        raise CameraError(f"the squares of a board have a side of some metres, as in 0.025, not {square:g}")
    return int(match[1]), int(match[2])
