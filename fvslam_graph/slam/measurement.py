"""Where landmarks are expected in the next image, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.sparse
from numpy.typing import NDArray

from fvslam_graph.camera import Camera
from fvslam_graph.slam.covariances import innovation, sparse_rows
from fvslam_graph.slam.landmarks import Array, hat, scaled_points
from fvslam_graph.slam.motion import travelled
from fvslam_graph.slam.state import State

GATE = 9.210  # 99 % quantile of the chi-square distribution with two degrees of freedom, as a pixel has
MAX_ITERATIONS = 10
CONVERGED = 0.2  # of a pixel's deviation; a smaller departure from linear ends the iteration


@dataclass(frozen=True)
class Prediction:
    """Where N landmarks are expected.

    Attributes:
        pixels: (N, 2); of no meaning where `in_front` is False.
        in_front: (N,) bool, of the camera.
        by_inverse: (M, 2, 12) Jacobian of those of landmarks in inverse depth by `State.columns`.
        by_point: (L, 2, 9) of those of points.
        columns: (M, 12) and (L, 9), the columns of these blocks.
        width: n, of the error state.
    """

    pixels: Array
    in_front: NDArray[np.bool_]
    by_inverse: Array
    by_point: Array
    columns: tuple[NDArray[np.intp], NDArray[np.intp]]
    width: int

    def jacobian(self, chosen: NDArray[np.bool_]) -> scipy.sparse.csr_array:
        """The Jacobian (2K, n) of the K chosen landmarks, (N,), by the error state."""
        first, second = np.split(chosen, [len(self.by_inverse)])
        blocks = [(self.by_inverse[first], self.columns[0][first]), (self.by_point[second], self.columns[1][second])]
        return sparse_rows(blocks, self.width)

    def innovation_covariances(self, state: State, chosen: NDArray[np.bool_], sigma: float) -> Array:
        """(K, 2, 2) of each chosen pixel on its own, with the deviation `sigma` of a match, pixels^2."""
        split = len(self.by_inverse)
        spread = []
        for jacobian, columns, part in (
            (self.by_inverse, self.columns[0], chosen[:split]),
            (self.by_point, self.columns[1], chosen[split:]),
        ):
            jacobian, columns = jacobian[part], columns[part]
            own = state.covariance[columns[:, :, None], columns[:, None, :]]
            spread.append(jacobian @ own @ jacobian.mT)
        whole = np.concatenate(spread) + sigma**2 * np.eye(2)
        return (whole + whole.mT) / 2


def predict_pixels(state: State, seconds: float, camera: Camera) -> Prediction:
    """Pixels of all landmarks after the step that the state's velocity says, with their Jacobian."""
    prev_T_cur, by_velocity = travelled(state.velocity, seconds)
    rotation, translation = prev_T_cur.rotation().matrix(), prev_T_cur.translation()
    # Landmarks as points times a weight, which is the inverse depth, or 1.
    scaled, by_scaled = scaled_points(state.inverse)
    weights = np.concatenate([state.inverse[:, 5], np.ones(len(state.points))])
    seen = (np.vstack([scaled, state.points]) - weights[:, None] * translation) @ rotation
    in_front = seen[:, 2] > 0
    depth = np.where(in_front, seen[:, 2], 1.0)
    pixels = seen[:, :2] / depth[:, None] * (camera.fx, camera.fy) + (camera.cx, camera.cy)

    by_seen = np.zeros((len(seen), 2, 3))
    by_seen[:, 0, 0], by_seen[:, 1, 1] = camera.fx / depth, camera.fy / depth
    by_seen[:, 0, 2], by_seen[:, 1, 2] = -camera.fx * seen[:, 0] / depth**2, -camera.fy * seen[:, 1] / depth**2
    # A pose perturbed by (w, v) on the right sees the point y with weight r at y + [y]x w - r v.
    seen_by_motion = np.zeros((len(seen), 3, 6))
    seen_by_motion[:, :, :3] = hat(seen)
    seen_by_motion[:, :, 3:] = -weights[:, None, None] * np.eye(3)
    by_velocity = by_seen @ (seen_by_motion @ by_velocity)

    split = len(state.inverse)
    by_scaled[:, :, 5] -= translation
    by_inverse, by_point = by_seen[:split] @ rotation.T @ by_scaled, by_seen[split:] @ rotation.T
    return Prediction(
        pixels,
        in_front,
        np.concatenate([by_velocity[:split], by_inverse], axis=2),
        np.concatenate([by_velocity[split:], by_point], axis=2),
        state.columns,
        len(state.covariance),
    )


def update(
    state: State,
    prediction: Prediction,
    chosen: NDArray[np.bool_],
    pixels: Array,
    seconds: float,
    camera: Camera,
    sigma: float,
) -> tuple[State, Prediction]:
    """The iterated EKF update (Bar-Shalom, Li, Kirubarajan 2001, section 10.5.2) with matched landmarks.

    With S = L L^T (`root`) and Y = L^-1 H P, the covariance becomes P - Y^T Y, which is symmetric to the bit.

    Args:
        state: Predicted, or updated with other matches.
        prediction: Of this state.
        chosen: (N,) which of the landmarks are measured.
        pixels: (N, 2) where they were matched.
        seconds: Since the previous frame.
        camera: Undistorted.
        sigma: Of a matched pixel along each axis.

    Returns:
        The updated state, and its own prediction.
    """
    if not chosen.any():
        return state, prediction
    origin, error = state, np.zeros(len(state.covariance))
    for _ in range(MAX_ITERATIONS):
        jacobian, expected = prediction.jacobian(chosen), prediction.pixels
        product, spread = innovation(jacobian, origin.covariance, sigma)
        root = np.linalg.cholesky(spread)
        surprise = (pixels - expected)[chosen].ravel() + jacobian @ error
        error = product.T @ scipy.linalg.cho_solve((root, True), surprise, check_finite=False)
        state = origin.moved(error)
        prediction = predict_pixels(state, seconds, camera)
        linear = surprise - jacobian @ error
        if np.abs((pixels - prediction.pixels)[chosen].ravel() - linear).max() < CONVERGED * sigma:
            break
    gain = scipy.linalg.solve_triangular(root, product, lower=True, check_finite=False)
    covariance = gain.T @ gain
    np.subtract(origin.covariance, covariance, out=covariance)  # in place: new memory costs more than the arithmetic
    return replace(state, covariance=covariance), prediction
