"""How well landmarks are seen, by their residuals."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import GraphSettings
from fvslam_graph.graph.factors import LandmarkFactors
from fvslam_graph.graph.pixel_noise import PixelNoise
from fvslam_graph.simulation.points import simulate_drive

from .conftest import PIXEL


@pytest.mark.parametrize(("kernel", "wrong"), [("cauchy", 0.1), ("none", 0.0)])
def test_the_graph_learns_the_noise(fed, kernel, wrong):
    """Whatever it starts from; with a kernel, also where a tenth of the pixels are wrong."""
    learnt = [
        fed(frames=61, seed=seed, pixel_sigma=3 * PIXEL, wrong_pixels=wrong, kernel=kernel).graph._noise.sigma
        for seed in range(3)
    ]
    assert np.mean(learnt) == pytest.approx(PIXEL, rel=0.5)  # measured 0.33


def test_residuals_of_triangulated_landmarks():
    """Three of the numbers of each landmark have gone into where it is."""
    scene = simulate_drive(frames=12, seed=0, noise=0.7, landmarks=4000)
    camera, poses = scene.camera, list(scene.trajectory.poses)
    calibration = gtsam.Cal3_S2(camera.fx, camera.fy, 0.0, camera.cx, camera.cy)
    noise, views = PixelNoise(5.0), {}
    for index in range(12):
        seen = scene.observe(index)
        for landmark, pixel in zip(seen.ids.tolist(), seen.pixels, strict=True):
            views.setdefault(landmark, []).append((index, pixel))
    points = {}
    for landmark, seen in views.items():
        if 3 <= len(seen) <= 5:
            for index, pixel in seen:
                noise.see(landmark, index, pixel)
            places, pixels = [poses[index] for index, _ in seen], [pixel for _, pixel in seen]
            points[landmark] = gtsam.triangulatePoint3(places, calibration, pixels, 1e-9, True)
    for _ in range(100):
        noise.learn(points, poses, camera)
    assert len(points) > 50
    assert noise.sigma == pytest.approx(0.7, rel=0.15)


def test_nothing_is_learnt_from_too_little():
    noise = PixelNoise(0.4)
    noise.learn({}, [], simulate_drive(frames=2, seed=0).camera)
    assert noise.sigma == 0.4


def test_landmarks_together_know_no_more_than_their_shared_error_allows():
    """The information of N landmarks about what they all measure."""
    scene = simulate_drive(frames=2, seed=0)
    factors = LandmarkFactors(scene.camera, GraphSettings(common_noise=1.5))
    for count in (1, 10, 1000):
        variance = factors.deviation(0.2, count) ** 2 / count
        assert variance >= (1.5 * 0.2) ** 2
    assert factors.deviation(0.2, 0) == pytest.approx(0.2)
