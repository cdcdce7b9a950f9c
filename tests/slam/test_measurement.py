"""Expected pixels, their derivatives, and the update."""

from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.slam.measurement import PixelModel, predict_pixels, update
from fvslam_graph.slam.motion import motion_from_velocity
from fvslam_graph.slam.state import POSE, SCALE

from .conftest import numeric

SECONDS = 0.1
SIGMA = 0.5  # pixels


@pytest.mark.parametrize("seed", range(20))
def test_derivative_of_pixels(random_state, camera, seed):
    """In both parametrisations, by velocity and landmark; pose and scale do not show in an image."""
    state = random_state(seed)
    prediction = predict_pixels(state, PixelModel(camera, SECONDS, SIGMA))
    analytic = prediction.jacobian(np.ones(len(state), bool)).toarray()
    step = 1e-7
    numerical = numeric(
        lambda e: predict_pixels(state.retract(e), PixelModel(camera, SECONDS, SIGMA)).pixels.ravel(),
        len(state.covariance),
        step,
    )
    scale = np.abs(numerical).max(axis=1, keepdims=True)
    assert np.abs((analytic - numerical) / scale).max() < 1e-6
    assert np.all(analytic[:, POSE] == 0) and np.all(analytic[:, SCALE] == 0)
    assert np.abs(numerical[:, SCALE]).max() < 1e-6 * scale.max()


def test_pixels_are_the_camera_s(random_state, camera):
    state = random_state(0)
    prev_T_cur, _ = motion_from_velocity(state.velocity, SECONDS)
    seen = prev_T_cur.transformTo(state.positions.T).T
    prediction = predict_pixels(state, PixelModel(camera, SECONDS, SIGMA))
    assert prediction.pixels == pytest.approx(camera.project(seen))


def test_landmarks_behind_the_camera_are_told(random_state, camera):
    state = random_state(0)
    turned = replace(state, velocity=np.array([0, np.pi / SECONDS, 0, 0, 0, 0]))
    prediction = predict_pixels(turned, PixelModel(camera, SECONDS, SIGMA))
    assert not prediction.in_front.any()
    assert np.isfinite(prediction.pixels).all()


def test_update_is_that_of_a_dense_filter(random_state, camera):
    """Joseph's form with the dense Jacobian; noise is large, so that one iteration is enough."""
    state = random_state(4, sigma=1e-4)
    chosen = np.arange(len(state)) % 3 > 0
    prediction = predict_pixels(state, PixelModel(camera, SECONDS, SIGMA))
    rng = np.random.default_rng(0)
    pixels = prediction.pixels + 0.01 * rng.standard_normal((len(state), 2))
    updated = update(prediction, chosen, pixels).state
    updated.check()

    H, P = prediction.jacobian(chosen).toarray(), state.covariance
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + SIGMA**2 * np.eye(len(H)))
    expected = state.retract(K @ (pixels - prediction.pixels)[chosen].ravel())
    rest = np.eye(len(P)) - K @ H
    assert updated.covariance == pytest.approx(rest @ P @ rest.T + SIGMA**2 * K @ K.T, rel=1e-6, abs=1e-14)
    assert updated.positions == pytest.approx(expected.positions, abs=1e-9)
    assert updated.velocity == pytest.approx(expected.velocity, abs=1e-9)


def test_exact_pixels_lead_to_where_they_are_exact(random_state, camera):
    """Far from linear: the iteration ends where the pixels are explained."""
    state = random_state(5, sigma=0.05)
    error = np.linalg.cholesky(state.covariance + 1e-12 * np.eye(len(state.covariance))) @ np.random.default_rng(
        1
    ).standard_normal(len(state.covariance))
    pixels = predict_pixels(state.retract(error), PixelModel(camera, SECONDS, SIGMA)).pixels
    everything = np.ones(len(state), bool)
    before = predict_pixels(state, PixelModel(camera, SECONDS, 1e-4))
    assert np.abs(before.pixels - pixels).max() > 1.0
    after = update(before, everything, pixels)
    assert np.abs(after.pixels - pixels).max() < 1e-2
    after.state.check()


def test_without_matches_nothing_changes(random_state, camera):
    state = random_state(0)
    prediction = predict_pixels(state, PixelModel(camera, SECONDS, SIGMA))
    assert update(prediction, np.zeros(len(state), bool), prediction.pixels).state is state


def test_innovation_covariances(random_state, camera):
    state = random_state(6)
    prediction = predict_pixels(state, PixelModel(camera, SECONDS, SIGMA))
    chosen = np.arange(len(state)) % 2 == 0
    H = prediction.jacobian(chosen).toarray()
    whole = H @ state.covariance @ H.T + SIGMA**2 * np.eye(len(H))
    expected = [whole[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(chosen.sum())]
    assert prediction.innovation_covariances(chosen) == pytest.approx(np.array(expected))
