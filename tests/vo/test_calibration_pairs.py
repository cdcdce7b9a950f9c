"""Pairs of images say of the calibration what they know, and no more where they differ."""

import numpy as np
import pytest

from fvslam_graph.core.vo_estimate import CalibrationEvidence
from fvslam_graph.vo.calibration_pairs import NUMBERS, PRIOR_SIGMAS, CalibrationPairs

FOCAL, K1, RIGHT, P2 = 0, 1, 3, 6


def summed(pairs):
    sums = CalibrationPairs()
    for pair in pairs:
        sums.add(pair)
    return sums


def drawn(rng, truth, count, excess=0.0):
    """Pairs that tell all numbers, with an error in k1 besides that their information does not say."""
    for _ in range(count):
        root = rng.standard_normal((NUMBERS, 12)) / PRIOR_SIGMAS[:, None] / 4
        told = root @ root.T
        off = truth + excess * rng.standard_normal() * np.eye(NUMBERS)[K1]
        noise = np.linalg.cholesky(told) @ rng.standard_normal(NUMBERS)
        yield CalibrationEvidence(told, told @ off + noise)


@pytest.mark.parametrize("number", [FOCAL, K1, RIGHT, P2])
def test_the_number_that_is_off_is_certain_and_no_other(camera, pair, number):
    """A principal point that is off, taken alone, would look like a focal length wrong by more than ten deviations."""
    truth = np.eye(NUMBERS)[number] * (0.01, 0.01, 0.01, 0.01, 0.01, 0.003, 0.003)[number]
    errors = summed(pair(camera.corrected(truth), 0.2, seed) for seed in range(25)).estimate()
    assert np.flatnonzero(errors.certain).tolist() == [number]
    assert errors.likeliest(errors.certain) == pytest.approx(truth, abs=0.25 * truth[number])  # measured 13 %


@pytest.mark.parametrize("seed", [0, 100, 200])
def test_nothing_is_certain_where_the_file_is_right(camera, pair, seed):
    errors = summed(pair(camera, 0.3, seed + number) for number in range(25)).estimate()
    assert not errors.certain.any() and not errors.likeliest(errors.certain).any()


def test_distortion_shows_in_turns(camera, pair):
    straight, turning = (summed(pair(camera, 0.2, seed, turn) for seed in range(20)).estimate() for turn in (0.0, 0.1))
    assert straight.sigmas[K1] > 5 * turning.sigmas[K1]  # measured 12


@pytest.mark.parametrize("excess", [0.0, 0.05])
def test_deviations_are_true_also_where_pairs_differ(excess):
    """Squared errors over squared deviations, the mean of many draws: 1 is expected."""
    squares = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        truth = PRIOR_SIGMAS * rng.standard_normal(NUMBERS)
        errors = summed(drawn(rng, truth, 30, excess=excess)).estimate()
        squares.append(((errors.likeliest(np.ones(NUMBERS, bool)) - truth) / errors.sigmas) ** 2)
    mean = np.mean(squares, axis=0)
    assert 0.5 < mean[K1] < 1.6  # measured 0.9 and 1.0
    assert np.all(mean < 1.3)  # not too certain of any


def test_pairs_that_differ_in_one_number_count_for_less_in_that_one():
    alike, differing = (summed(drawn(np.random.default_rng(0), 0, 60, excess=excess)).estimate() for excess in (0, 0.1))
    assert differing.sigmas[K1] > 1.5 * alike.sigmas[K1]  # measured 1.9
    assert differing.sigmas[P2] < 1.5 * alike.sigmas[P2]  # measured 1.1


def test_the_likeliest_gains_most():
    truth = 3 * PRIOR_SIGMAS
    sums = summed(drawn(np.random.default_rng(0), truth, 20))
    assert sums.gain(truth) > sums.gain(0.8 * truth) > sums.gain(0 * truth) == 0


def test_news_are_what_came_since():
    """Two halves say together what all pairs say, but for what is not known of the other numbers in each."""
    pairs = list(drawn(np.random.default_rng(0), 0, 40))
    sums = summed(pairs[:20])
    halves = [sums.news(2)]
    for late in pairs[20:]:
        sums.add(late)
    halves.append(sums.news(2))
    whole = summed(pairs).news(2)
    assert sum(half.information for half in halves) == pytest.approx(whole.information, rel=0.2)  # measured 8 %
    assert np.all(np.linalg.eigvalsh(halves[0].information) > 0)
