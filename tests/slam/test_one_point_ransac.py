"""Which matches agree."""

from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.core.config import SlamSettings
from fvslam_graph.slam.measurement import PixelModel, predict_pixels
from fvslam_graph.slam.one_point_ransac import low_innovation_inliers

SECONDS, SIGMA, SLACK = 0.1, 0.5, 1.0


@pytest.fixture
def matched(random_state, camera):
    """A state with landmarks known well and a motion known badly, and where a true motion leads them to."""

    def make(seed: int):
        state = random_state(seed, 20, 10, 1e-3)
        covariance = state.covariance.copy()
        covariance[7:13, 7:13] += np.diag(np.repeat([0.2, 1.0], 3) ** 2)
        state = replace(state, covariance=covariance)
        rng = np.random.default_rng(seed)
        error = np.zeros(len(covariance))
        error[7:13] = np.repeat([0.2, 1.0], 3) * rng.standard_normal(6)
        prediction = predict_pixels(state, PixelModel(camera, SECONDS, SIGMA))
        true = predict_pixels(state.retract(error), PixelModel(camera, SECONDS, SIGMA)).pixels
        return state, prediction, true + 0.2 * rng.standard_normal(true.shape), rng

    return make


def run(prediction, pixels, found, seed=0):
    return low_innovation_inliers(prediction, pixels, found, SLACK, np.random.default_rng(seed))


def test_half_of_the_matches_may_be_wrong(matched, camera):
    """No wrong one is taken for right; where few agree, in about one of fifty of these small scenes, that is told."""
    right = 0
    for seed in range(50):
        state, prediction, pixels, rng = matched(seed)
        found = np.ones(len(state), bool)
        wrong = np.arange(len(state)) % 2 == 0
        pixels[wrong] += rng.choice([-1, 1], (wrong.sum(), 2)) * rng.uniform(8, 30, (wrong.sum(), 2))
        inliers, votes = run(prediction, pixels, found)
        assert 0 <= votes <= inliers.sum()
        told = votes < SlamSettings().min_matches
        assert told or not (inliers & wrong).any()
        right += not told and inliers[~wrong].mean() > 0.9
    assert right >= 47  # measured 48


def test_only_what_was_found_agrees(matched, camera):
    state, prediction, pixels, _ = matched(0)
    found = np.arange(len(state)) < 12
    inliers, _ = run(prediction, pixels, found)
    assert not inliers[~found].any() and inliers[found].all()
    none, votes = run(prediction, pixels, np.zeros(len(state), bool))
    assert not none.any() and votes == 0


def test_the_same_seed_draws_the_same_matches(matched, camera):
    state, prediction, pixels, rng = matched(1)
    pixels[::2] += rng.uniform(-30, 30, (15, 2))
    found = np.ones(len(state), bool)
    first, second = (run(prediction, pixels, found, 3)[0] for _ in range(2))
    assert np.array_equal(first, second)


def test_landmarks_at_unknown_depths_have_little_to_say(random_state, camera):
    """A strip that goes across the image agrees with many a motion."""
    state = random_state(2, 20, 0, 1e-3)
    vague = state.covariance.copy()
    rows = state.parts[1][:, 2]
    vague[rows, rows] += (3 * state.inverse_depth[:, 2]) ** 2
    vague_state = replace(state, velocity=5 * state.velocity, covariance=vague)
    prediction = predict_pixels(vague_state, PixelModel(camera, SECONDS, SIGMA))
    inliers, votes = run(prediction, prediction.pixels.copy(), np.ones(20, bool))
    assert inliers.all()
    assert votes < 8  # measured 2.6
