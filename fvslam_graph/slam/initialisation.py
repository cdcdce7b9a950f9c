"""New landmarks: where the filter's map begins and grows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.known_points import KnownPoints
from fvslam_graph.slam.covariances import extended, selected
from fvslam_graph.slam.inverse_depth import Array, angles
from fvslam_graph.slam.state import FIXED, ODOMETRY, PART, SCALE, State

NEIGHBOURHOOD = 0.1  # of the image's width: landmarks this near to a pixel tell most about its depth


@dataclass(frozen=True)
class DepthPrior:
    """Expected inverse distances of K new landmarks.

    Attributes:
        inverse: (K,) 1/metres.
        covariance: (K, K) of what the state does not know of them.
        J_state: (K, n) how they depend on the error state; zero where they do not.
    """

    inverse: Array
    covariance: Array
    J_state: Array


def known_depths(points: KnownPoints, camera: Camera, state: State) -> DepthPrior:
    """From points of known depth, which share the scale of odometry and the errors of a motion."""
    stretch = np.linalg.norm(np.column_stack([camera.normalize(points.pixels), np.ones(len(points))]), axis=1)
    stretch *= math.exp(state.odometry_scale)  # as distances are longer than depths
    inverse, common = points.inverse_depths / stretch, points.common / stretch[:, None]
    covariance = np.diag((points.sigmas / stretch) ** 2) + common @ common.T
    # Depths are metric but for the scale of odometry, and the map is uncertain of its own.
    J_state = np.zeros((len(points), len(state.covariance)))
    J_state[:, SCALE], J_state[:, ODOMETRY] = inverse, -inverse
    return DepthPrior(inverse, covariance, J_state)


def depths_from_map(state: State, pixels: Array, camera: Camera, spread: float) -> DepthPrior | None:
    """A prior as far away as the landmarks around in the image; None without landmarks in front of the camera.

    The logarithm of the inverse distance is a weighted mean over the map, plus noise of deviation `spread`. It goes
    along with the map's scale, which it so tells nothing about: a fixed prior would pull at it.

    Args:
        state: With the map in the present camera.
        pixels: (K, 2) of the new landmarks.
        camera: Undistorted.
        spread: Standard deviation of the logarithm.
    """
    front, logs, jacobian = state.log_distances()
    if not front.any():
        return None
    apart = pixels[:, None] - camera.project(np.where(front[:, None], state.positions, (0.0, 0.0, 1.0)))
    square = np.where(front, (apart**2).sum(axis=2), np.inf) / (NEIGHBOURHOOD * camera.width) ** 2
    weight = np.exp(-0.5 * (square - square.min(axis=1, keepdims=True)))
    weight /= weight.sum(axis=1, keepdims=True)
    inverse = np.exp(-weight @ logs)
    J_logs = np.zeros((len(state), len(state.covariance)))
    J_logs[np.arange(len(state))[:, None], state.columns] = jacobian
    J_state = -inverse[:, None] * (weight @ J_logs)
    return DepthPrior(inverse, np.diag((spread * inverse) ** 2), J_state)


def equal_depths(count: int, distance: float, spread: float, size: int) -> DepthPrior:
    """All at one distance, metres, with the deviation `spread` of its logarithm: where nothing is known."""
    inverse = np.full(count, 1 / distance)
    return DepthPrior(inverse, np.diag((spread * inverse) ** 2), np.zeros((count, size)))


def with_new_landmarks(
    state: State, ids: NDArray[np.int64], pixels: Array, prior: DepthPrior, camera: Camera, sigma: float
) -> State:
    """The state with landmarks in inverse depth, whose common anchor is the present camera, and exact.

    Args:
        state: As seen from the present camera.
        ids: (K,) of the new landmarks.
        pixels: (K, 2) where they are seen.
        prior: Their inverse distances.
        camera: Undistorted.
        sigma: Of the pixels along each axis.
    """
    rays = camera.rays(pixels)
    pointing, J_ray = angles(rays)
    J_pixel = J_ray[:, :, :2] / (camera.fx, camera.fy)
    # Only the inverse distances depend on what is in the state. The anchor comes first, and is certain.
    cross = np.zeros((1 + len(ids), PART, len(state.covariance)))
    cross[1:, 2] = prior.J_state @ state.covariance
    P_new = np.zeros((1 + len(ids), PART) * 2)
    each = np.arange(1, 1 + len(ids))
    P_new[each, :2, each, :2] = sigma**2 * J_pixel @ J_pixel.mT
    P_new[1:, 2, 1:, 2] = prior.covariance + cross[1:, 2] @ prior.J_state.T
    size = cross.shape[0] * PART
    covariance = extended(state.covariance, cross.reshape(size, -1), P_new.reshape(size, size))

    # All anchors come first, then all rays, then all points.
    anchors, inverse_depth, points = state.parts
    new = len(state.covariance) + np.arange(size)
    order = np.concatenate(
        [np.arange(FIXED), anchors.ravel(), new[:PART], inverse_depth.ravel(), new[PART:], points.ravel()]
    )
    split = len(state.inverse_depth)
    return replace(
        state,
        anchors=np.vstack([state.anchors, np.zeros(3)]),
        inverse_depth=np.vstack([state.inverse_depth, np.column_stack([pointing, prior.inverse])]),
        anchor_of=np.concatenate([state.anchor_of, np.full(len(ids), len(state.anchors))]),
        ids=np.concatenate([state.ids[:split], ids, state.ids[split:]]),
        covariance=selected(covariance, order),
    )
