"""How the image turns, grows and moves from frame to frame: coarse, cheap, and without a map."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Image
from fvslam_graph.core.sequence import Sequence

REDUCED_WIDTH = 320  # pixels that images are reduced to
INTERVAL = 0.1  # seconds between the images that are compared, at least
_POINTS, _QUALITY, _SPACING = 200, 0.01, 8
MIN_CORNERS = 20
_TOLERANCE = 1.0  # pixels


class ImageMotion(NamedTuple):
    """Rates between pairs of images.

    Attributes:
        stamps: (N,) seconds, in the middle of each pair.
        turn: (N,) rad/s about the optical axis, clockwise as the scene is seen.
        growth: (N,) 1/s, of the scale of the image.
        flow: (N,) rad/s, how fast the middle of the image moves.
    """

    stamps: NDArray[np.float64]
    turn: NDArray[np.float64]
    growth: NDArray[np.float64]
    flow: NDArray[np.float64]


def measure_image_motion(sequence: Sequence) -> ImageMotion:
    """The rates of a whole recording, by a similarity that most tracked corners of each pair follow."""
    camera = sequence.camera.scaled(min(1.0, REDUCED_WIDTH / sequence.camera.width))
    rows = []
    last: tuple[float, Image] | None = None
    for index, stamp in enumerate(sequence.stamps):
        if last is not None and stamp - last[0] < INTERVAL - 1e-6:
            continue
        image = sequence.load(index)
        if image is None:
            continue
        reduced = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        if last is not None and (similarity := _similarity(last[1], reduced, camera)) is not None:
            duration = stamp - last[0]
            scale = np.hypot(similarity[0, 0], similarity[1, 0])
            turn = np.arctan2(similarity[1, 0], similarity[0, 0])
            flow = np.hypot(*similarity[:, 2]) / camera.fx
            rows.append([stamp - duration / 2, turn / duration, np.log(scale) / duration, flow / duration])
        last = (float(stamp), reduced)
    return ImageMotion(*np.array(rows, float).reshape(-1, 4).T)


def _similarity(before: Image, after: Image, camera: Camera) -> NDArray[np.float64] | None:
    """The similarity (2, 3) about the principal point, pixels; None where too few corners follow one."""
    corners = cv2.goodFeaturesToTrack(before, _POINTS, _QUALITY, _SPACING)
    if corners is None or len(corners) < MIN_CORNERS:
        return None
    moved, found, _ = cv2.calcOpticalFlowPyrLK(before, after, corners, None)
    good = found[:, 0] > 0
    if good.sum() < MIN_CORNERS:
        return None
    centre = np.array([camera.cx, camera.cy])
    source, target = (points[good].reshape(-1, 2) - centre for points in (corners, moved))
    similarity, inliers = cv2.estimateAffinePartial2D(source, target, ransacReprojThreshold=_TOLERANCE)
    return None if similarity is None or inliers.sum() < MIN_CORNERS else np.asarray(similarity, float)
