"""Where landmarks are expected in the next image, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.gates import chi2_gate
from fvslam_graph.slam.covariances import each_transformed, innovation_covariance, sparse_rows
from fvslam_graph.slam.inverse_depth import Array, hat, scaled_points
from fvslam_graph.slam.motion import motion_from_velocity
from fvslam_graph.slam.state import FIXED, VELOCITY, State

if TYPE_CHECKING:
    from scipy.sparse import csr_array

PIXEL_GATE = chi2_gate(0.99, 2)  # of a pixel
MAX_ITERATIONS = 10
MIN_DEPARTURE = 0.2  # of a pixel's deviation; a smaller departure from linear ends the iteration


@dataclass(frozen=True)
class PixelModel:
    """How the pixels of landmarks depend on the state.

    Attributes:
        camera: Undistorted.
        seconds: Since the previous frame.
        sigma: Of a matched pixel along each axis.
    """

    camera: Camera
    seconds: float
    sigma: float


@dataclass(frozen=True)
class Prediction:
    """Where a state expects its N landmarks.

    Attributes:
        state: Before the step into the new camera.
        model: Of the pixels.
        pixels: (N, 2); of no meaning where `in_front` is False.
        in_front: (N,) bool, of the camera.
        blocks: (N, 2, 12) their Jacobian by what each depends on: the velocity, and the landmark itself.
        columns: (N, 12) the columns of these blocks.
    """

    state: State
    model: PixelModel
    pixels: Array
    in_front: NDArray[np.bool_]
    blocks: Array
    columns: NDArray[np.intp]

    def jacobian(self, chosen: NDArray[np.bool_]) -> csr_array:
        """The Jacobian (2K, n) of the K chosen landmarks, (N,), by the error state."""
        return sparse_rows([(self.blocks[chosen], self.columns[chosen])], len(self.state.covariance))

    def innovation_covariances(self, chosen: NDArray[np.bool_]) -> Array:
        """(K, 2, 2) of each chosen pixel on its own, with the noise of a match, pixels^2."""
        S = each_transformed(self.state.covariance, self.blocks[chosen], self.columns[chosen])
        S = S + self.model.sigma**2 * np.eye(2)
        return (S + S.mT) / 2


def predict_pixels(state: State, model: PixelModel) -> Prediction:
    """Pixels of all landmarks after the step that the state's velocity says, with their Jacobian."""
    camera = model.camera
    prev_T_cur, J_velocity = motion_from_velocity(state.velocity, model.seconds)
    rotation, translation = prev_T_cur.rotation().matrix(), prev_T_cur.translation()
    # Landmarks as points times a weight, which is the inverse depth, or 1.
    scaled, J_scaled = scaled_points(state.anchored_inverse_depth)
    split = len(scaled)
    weights = np.concatenate([state.anchored_inverse_depth[:, 5], np.ones(len(state.points))])
    seen = (np.vstack([scaled, state.points]) - weights[:, None] * translation) @ rotation
    in_front = seen[:, 2] > 0
    depth = np.where(in_front, seen[:, 2], 1.0)
    pixels = seen[:, :2] / depth[:, None] * (camera.fx, camera.fy) + (camera.cx, camera.cy)

    J_seen = np.zeros((len(seen), 2, 3))
    J_seen[:, 0, 0], J_seen[:, 1, 1] = camera.fx / depth, camera.fy / depth
    J_seen[:, 0, 2], J_seen[:, 1, 2] = -camera.fx * seen[:, 0] / depth**2, -camera.fy * seen[:, 1] / depth**2
    # A pose perturbed by (w, v) on the right sees the point y with weight r at y + [y]x w - r v.
    J_seen_motion = np.zeros((len(seen), 3, 6))
    J_seen_motion[:, :, :3] = hat(seen)
    J_seen_motion[:, :, 3:] = -weights[:, None, None] * np.eye(3)
    J_landmark = np.zeros((len(seen), 3, 6))
    J_landmark[:split], J_landmark[split:, :, 3:] = J_scaled, np.eye(3)
    J_landmark[:split, :, 5] -= translation
    blocks, columns = np.empty((len(seen), 2, 12)), np.empty((len(seen), 12), np.intp)
    blocks[:, :, :6], blocks[:, :, 6:] = J_seen @ (J_seen_motion @ J_velocity), J_seen @ rotation.T @ J_landmark
    columns[:, :6], columns[:, 6:] = np.arange(FIXED)[VELOCITY], state.columns
    return Prediction(state, model, pixels, in_front, blocks, columns)


def update(prediction: Prediction, chosen: NDArray[np.bool_], pixels: Array) -> Prediction:
    """The iterated EKF update (Bar-Shalom, Li, Kirubarajan 2001, section 10.5.2) with matched landmarks.

    With S = L L^T and Y = L^-1 H P, the covariance becomes P - Y^T Y, which is symmetric to the bit.

    Args:
        prediction: Of a state that is predicted, or updated with other matches.
        chosen: (N,) which of the landmarks are measured.
        pixels: (N, 2) where they were matched.

    Returns:
        The prediction of the updated state.
    """
    from scipy.linalg import cho_solve, solve_triangular

    if not chosen.any():
        return prediction
    origin, model = prediction.state, prediction.model
    error = np.zeros(len(origin.covariance))
    for _ in range(MAX_ITERATIONS):
        jacobian, expected = prediction.jacobian(chosen), prediction.pixels
        HP, S = innovation_covariance(jacobian, origin.covariance, model.sigma)
        L = np.linalg.cholesky(S)
        innovation = (pixels - expected)[chosen].ravel() + jacobian @ error
        error = HP.T @ cho_solve((L, True), innovation, check_finite=False)
        prediction = predict_pixels(origin.retract(error), model)
        linear = innovation - jacobian @ error
        if np.abs((pixels - prediction.pixels)[chosen].ravel() - linear).max() < MIN_DEPARTURE * model.sigma:
            break
    Y = solve_triangular(L, HP, lower=True, check_finite=False)
    covariance = Y.T @ Y
    np.subtract(origin.covariance, covariance, out=covariance)  # in place: new memory costs more than the arithmetic
    return replace(prediction, state=replace(prediction.state, covariance=covariance))
