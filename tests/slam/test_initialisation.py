"""New landmarks: where they are seen, what they depend on, and that they tell nothing about the scale."""

from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.core.known_points import KnownPoints
from fvslam_graph.slam.initialisation import depths_from_map, equal_depths, known_depths, with_new_landmarks
from fvslam_graph.slam.measurement import PixelModel, predict_pixels
from fvslam_graph.slam.state import ODOMETRY, SCALE

from .conftest import agrees, numeric

PIXELS = np.array([[100.0, 80.0], [320.5, 240.5], [500.0, 400.0]])
IDS = np.array([100, 101, 102])


def standing(state):
    return replace(state, velocity=np.zeros(6))


def test_a_new_landmark_is_where_it_is_seen(random_state, camera):
    state = standing(random_state(0))
    prior = equal_depths(3, 8.0, 0.5, len(state.covariance))
    grown = with_new_landmarks(state, IDS, PIXELS, prior, camera, 0.5)
    grown.check()
    new = np.isin(grown.ids, IDS)
    prediction = predict_pixels(grown, PixelModel(camera, 0.1, 0.5))
    assert prediction.pixels[new] == pytest.approx(PIXELS)
    assert np.linalg.norm(grown.positions[new], axis=1) == pytest.approx([8.0] * 3)
    # Seen again at once, it is as uncertain as the first pixel and the second.
    velocity_known = replace(grown, covariance=grown.covariance * _without_velocity(grown))
    spread = predict_pixels(velocity_known, PixelModel(camera, 0.1, 0.5)).innovation_covariances(new)
    assert spread == pytest.approx(np.tile(0.5 * np.eye(2), (3, 1, 1)), rel=1e-6, abs=1e-9)
    assert grown.positions[~new] == pytest.approx(state.positions)
    nothing = np.zeros(len(grown.inverse_depth), bool)
    assert grown.without(new, nothing).covariance == pytest.approx(state.covariance)


def _without_velocity(state):
    known = np.ones(len(state.covariance))
    known[7:13] = 0.0
    return np.outer(known, known)


@pytest.mark.parametrize("seed", range(5))
def test_depths_from_the_map_depend_on_it(random_state, camera, seed):
    state = random_state(seed)
    prior = depths_from_map(state, PIXELS, camera, 0.5)

    def inverse(error):
        # Which landmarks are near in the image is not differentiated: pixels are asked for where the map was.
        moved = state.retract(error)
        front, _, _ = state.log_distances()
        apart = PIXELS[:, None] - camera.project(state.positions)
        square = np.where(front, (apart**2).sum(axis=2), np.inf) / (0.1 * camera.width) ** 2
        weight = np.exp(-0.5 * (square - square.min(axis=1, keepdims=True)))
        weight /= weight.sum(axis=1, keepdims=True)
        return np.exp(-weight @ moved.log_distances()[1])

    assert prior.inverse == pytest.approx(inverse(np.zeros(len(state.covariance))))
    numerical = numeric(inverse, len(state.covariance), 1e-7)
    numerical[:, SCALE] = 0.0  # the map's own units
    assert agrees(prior.J_state, numerical)


@pytest.mark.parametrize("seed", range(5))
def test_landmarks_as_far_as_the_map_tell_nothing_of_its_scale(random_state, camera, seed):
    """If all lengths of the map grow by a factor, so do those of what begins in it."""
    state = random_state(seed).with_scale_decoupled()
    prior = depths_from_map(state, PIXELS, camera, 0.5)
    assert prior.J_state @ state.J_scale == pytest.approx(-prior.inverse)
    grown = with_new_landmarks(state, IDS, PIXELS, prior, camera, 0.5)
    grown.check()
    assert grown.covariance[SCALE, SCALE] == state.covariance[SCALE, SCALE]


def test_known_depths_are_metric(random_state, camera):
    """But for the scale of odometry."""
    state = replace(random_state(0), odometry_scale=0.1)
    known = np.ones(len(state.covariance))
    known[ODOMETRY] = 0.0
    state = replace(state, covariance=state.covariance * np.outer(known, known) + 0.03**2 * np.diag(1 - known))
    depths, sigmas = np.array([0.1, 0.2, 0.5]), np.array([0.01, 0.01, 0.02])
    points = KnownPoints(IDS, PIXELS, depths, sigmas, np.zeros((3, 0)), 0.03**2)
    prior = known_depths(points, camera, state)
    stretch = np.linalg.norm(np.column_stack([camera.normalize(PIXELS), np.ones(3)]), axis=1)
    stretch *= np.exp(0.1)
    assert prior.inverse == pytest.approx(points.inverse_depths / stretch)
    assert np.diag(prior.covariance) == pytest.approx((points.sigmas / stretch) ** 2)
    # However uncertain the map's scale is, a known depth is as certain as it was told.
    uncertain = replace(state, covariance=state.covariance + 0.5 * np.diag(np.eye(len(state.covariance))[SCALE]))
    grown = with_new_landmarks(uncertain, IDS, PIXELS, prior, camera, 1e-6)
    new = np.isin(grown.ids, IDS)
    depth_variance = grown.position_covariances()[new][:, 2, 2]
    expected = (points.sigmas / points.inverse_depths**2) ** 2 + (0.03 / points.inverse_depths) ** 2
    assert depth_variance == pytest.approx(np.exp(0.2) * expected, rel=0.05)


def test_known_depths_share_the_errors_of_a_motion(random_state, camera):
    common = np.random.default_rng(0).normal(0, 0.01, (3, 5))
    points = KnownPoints(IDS, PIXELS, np.array([0.1, 0.2, 0.5]), np.full(3, 0.01), common, 0.0)
    state = random_state(0)
    grown = with_new_landmarks(state, IDS, PIXELS, known_depths(points, camera, state), camera, 0.5)
    grown.check()
    stretch = np.linalg.norm(np.column_stack([camera.normalize(PIXELS), np.ones(3)]), axis=1)
    rows = grown.parts[1][np.isin(grown.ids[: len(grown.inverse_depth)], IDS), 2]
    J_scale = np.zeros(len(state.covariance))
    J_scale[[SCALE, ODOMETRY]] = 1.0, -1.0
    scale_variance = J_scale @ state.covariance @ J_scale
    uncertain_scale = np.outer(points.inverse_depths, points.inverse_depths) * scale_variance
    expected = (1e-4 * np.eye(3) + common @ common.T + uncertain_scale) / np.outer(stretch, stretch)
    assert grown.covariance[np.ix_(rows, rows)] == pytest.approx(expected)


def test_without_a_map_there_is_no_depth_to_take_over(random_state, camera):
    state = random_state(0)
    empty = state.without(np.ones(len(state), bool), np.zeros(len(state.inverse_depth), bool))
    assert depths_from_map(empty, PIXELS, camera, 0.5) is None
    assert empty.with_scale_decoupled() is empty
