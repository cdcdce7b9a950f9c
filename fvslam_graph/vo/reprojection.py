"""Reprojection errors of tracks whose depths are known well, roughly or not at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.inverse_depths import InverseDepths
from fvslam_graph.core.quick import median
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.vo.epipolar import bends

MIN_DEPTH_RATIO = 0.05  # times as far away as in the keyframe: nearer than that, nothing is followed

AGREES = 4.0  # standard deviations, at most, of a track that agrees

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReprojectionErrors:
    """Errors of N tracks in standard deviations: across the epipolar line, and then what the depth says along it.

    Attributes:
        values: (N, 2).
        J_pose: (N, 2, 6) in the tangent of keyframe_T_cur.
        J_common: (N, 2, S) what each of the errors that depths share adds to them.
        sharp: (N,) whether the texture tells much across the line.
        ahead: (N,) whether the point is seen before the camera, apart from noise.
        J_calibration: Works out how they change with the logarithm of the focal length, and with k1, (N, 2, 2), as in
            `calibration_jacobian`: only the last of many steps asks.
    """

    values: Array
    J_pose: Array
    J_common: Array
    sharp: NDArray[np.bool_]
    ahead: NDArray[np.bool_]
    J_calibration: Callable[[], Array]

    @property
    def squares(self) -> Array:
        """(N,) squared lengths."""
        squares: Array = np.vecdot(self.values, self.values)
        return squares

    @property
    def agree(self) -> NDArray[np.bool_]:
        """(N,) whether a track agrees with the pose."""
        return self.ahead & (self.squares < AGREES**2)

    @property
    def deviation(self) -> float:
        """Robust standard deviation across the lines where texture tells it, of those that agree; 1 if all is right."""
        agree = self.agree
        across = np.abs(self.values[self.sharp & agree if np.any(self.sharp & agree) else agree, 0])
        return median(across) / 0.6745 if len(across) else 1.0


def reprojection_errors(
    keyframe_T_cur: gtsam.Pose3, rays: Array, tracks: Tracks, depths: InverseDepths, camera: Camera, noise: float
) -> ReprojectionErrors:
    """Reprojection errors with depths marginalised, each linearised where the point most likely is.

    An error across the epipolar line counts at any depth. How far along it the point is seen tells as much as its
    depth is known; a point of unknown depth tells what it tells in two views.

    Args:
        keyframe_T_cur: Metres.
        rays: (N, 3) of the tracks in the keyframe, z = 1.
        tracks: N.
        depths: (N,) theirs, in the keyframe; unknown ones have a large sigma. What they err together is no noise.
        camera: Undistorted.
        noise: Pixels, of a corner's displacement along each axis.
    """
    R, t = keyframe_T_cur.rotation().matrix(), keyframe_T_cur.translation()
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    turned, step = rays @ R, t @ R

    def project(values: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Normalised coordinates, depth and nearness, error in the image and its derivative along the line."""
        seen = turned - values[:, None] * step
        z = np.maximum(seen[:, 2], MIN_DEPTH_RATIO)
        xy = seen[:, :2] / z[:, None]
        return xy, z, values / z, focal * xy + centre - tracks.current, focal * (xy * step[2] - step[:2]) / z[:, None]

    variance = depths.sigmas**2
    _, _, _, error, line = project(depths.values)
    square = np.maximum(np.vecdot(line, line), 1e-12)
    share = 1 / (1 + noise**2 / np.maximum(variance * square, 1e-300))  # of the way to where the image has the point
    likeliest = depths.values - share * np.vecdot(error, line) / square
    xy, depth, near, error, line = project(likeliest)
    error = error + line * (depths.values - likeliest)[:, None]

    x, y = xy.T
    zero = np.zeros_like(x)
    J_pose = np.empty((len(x), 2, 6))  # a pose perturbed by (w, v) on the right sees the point at p + [p]x w - v
    J_pose[:, 0] = camera.fx * np.stack([x * y, -(1 + x * x), y, -near, zero, near * x], axis=1)
    J_pose[:, 1] = camera.fy * np.stack([1 + y * y, -x * y, -x, zero, -near, near * y], axis=1)

    speed = np.hypot(*line.T)
    along = np.where(speed[:, None] > 1e-6, line, [1.0, 0.0]) / np.where(speed > 1e-6, speed, 1.0)[:, None]
    axes = np.stack([np.stack([-along[:, 1], along[:, 0]], axis=1), along], axis=1)
    S = axes @ tracks.covariances @ axes.mT
    # Across, and along given that; a variance of the depth comes to the latter alone.
    given = S[:, 0, 1] / S[:, 0, 0]
    sigma = np.sqrt(noise**2 * (S[:, 1, 1] - given * S[:, 0, 1]) + np.minimum(variance * speed**2, 1e12))
    white = np.zeros((len(x), 2, 2))
    white[:, 0, 0] = 1 / (noise * np.sqrt(S[:, 0, 0]))
    white[:, 1, 0], white[:, 1, 1] = -given / sigma, 1 / sigma
    white = white @ axes
    J_common = np.zeros((len(x), 2, depths.common.shape[1]))
    J_common[:, 1] = (speed / sigma)[:, None] * depths.common
    values = (white @ error[:, :, None])[:, :, 0]
    ahead = likeliest * speed > -AGREES * noise

    def J_calibration() -> Array:
        there = (tracks.current - centre) / focal
        changes: Array = white @ _calibration_jacobian(rays[:, :2], there, R, (xy, depth), focal)
        changes[:, 1] += (speed / sigma)[:, None] * depths.J_calibration
        return changes

    return ReprojectionErrors(values, white @ J_pose, J_common, S[:, 0, 0] < 2, ahead, J_calibration)


def _calibration_jacobian(seen: Array, there: Array, R: Array, expected: tuple[Array, Array], focal: Array) -> Array:
    """(N, 2, 2) how errors in the image, pixels, change with the logarithm of the focal length and with k1.

    Args:
        seen: (N, 2) normalised coordinates in the keyframe,
        there: and where the points are found now.
        R: Rotation of the current camera in the keyframe.
        expected: (N, 2) normalised coordinates and (N,) depths where they are expected.
        focal: (2,) pixels.
    """
    xy, depth = expected
    J_calibration = np.empty((len(xy), 2, 2))
    for column, (first, second) in enumerate(zip(-bends(seen)[:2], -bends(there)[:2], strict=True)):
        change = first @ R[:2]
        J_calibration[:, :, column] = focal * ((change[:, :2] - xy * change[:, 2:]) / depth[:, None] - second)
    return J_calibration
