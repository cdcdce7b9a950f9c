"""Motions of odometry that landmarks contradict."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.graph.gating import MIN_LANDMARKS, contradiction

CAMERA = Camera(640, 480, 450.0, 440.0, 319.5, 239.5)
TRUE = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.02, -0.05, 0.1), np.array([0.3, -0.1, 1.5]))
SIGMAS = np.repeat([0.001, 0.02], 3)  # rad and m, of the motions
PIXEL = 0.3


def judged(error: np.ndarray, seed: int, count: int = 40, wrong: float = 0.2) -> GaussianPose | None:
    """What is said where odometry is off by an error (6,), and so many of the landmarks are."""
    rng = np.random.default_rng(seed)
    there = rng.uniform((-4, -3, 5), (4, 3, 20), (count, 3))
    pixels = CAMERA.project(there) + PIXEL * rng.standard_normal((count, 2))
    elsewhere = rng.random(count) < wrong
    pixels[elsewhere] += rng.uniform(-60, 60, (elsewhere.sum(), 2))
    points = TRUE.transformFrom(there.T).T
    points[::7] = np.nan
    expected = GaussianPose(TRUE.retract(error), np.diag(SIGMAS**2))
    return contradiction(expected, points, pixels, CAMERA, PIXEL, seed)


@pytest.mark.parametrize("seed", range(20))
def test_gross_errors_are_told_from_those_that_are_claimed(seed):
    rng = np.random.default_rng([seed, 1])
    assert judged(2 * SIGMAS * rng.standard_normal(6), seed) is None
    found = judged(0.2 * rng.choice([-1, 1], 6) * np.repeat([1.0, 5.0], 3), seed)
    assert found is not None
    error = gtsam.Pose3.Logmap(found.mean.between(TRUE))
    assert np.abs(error).max() < 0.05
    assert error @ np.linalg.solve(found.covariance, error) < 25  # 99.97 % of those with six degrees of freedom


def test_without_agreement_nothing_is_contradicted():
    gross = np.full(6, 0.3)
    assert judged(gross, 0, count=MIN_LANDMARKS) is None  # a seventh of them is of unknown depth
    assert judged(gross, 0, wrong=1.0) is None
