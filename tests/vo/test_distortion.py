"""Radial distortion that a calibration has left, from tracks alone."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import VoSettings
from fvslam_graph.core.errors import EstimationError
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.vo.distortion import RadialDistortion, measure_distortion
from fvslam_graph.vo.relative_pose import estimate_relative_pose


def bent(camera, pixels, k1, noise, rng):
    seen = camera.normalize(pixels)
    distorted = replace(camera, distortion="radtan", coefficients=(k1, 0, 0, 0))
    pixels = distorted.project(np.column_stack([seen, np.ones(len(seen))]))
    return pixels + noise * rng.standard_normal(pixels.shape)


def measured(camera, two_views, k1, noise, pairs, turn=0.05):
    """By pairs of views of a camera that goes ahead and turns."""
    rng, distortion = np.random.default_rng(0), RadialDistortion(camera)
    for seed in range(pairs):
        motion = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.0, turn, 0.01])), np.array([0.1, 0.05, 1.0]))
        tracks = two_views(motion, seed=seed).tracks
        tracks = Tracks.alike(
            tracks.ids, *(bent(camera, at, k1, noise, rng) for at in (tracks.keyframe, tracks.current))
        )
        pose = estimate_relative_pose(tracks, camera, VoSettings(), seed=0)
        distortion.add(tracks[pose.inliers], gtsam.Pose3(pose.rotation, pose.direction))
    return distortion.estimate()


@pytest.mark.parametrize("k1", [0.005, -0.005])
def test_exact_pixels(camera, two_views, k1):
    found, sigma = measured(camera, two_views, k1, noise=0, pairs=10)
    assert found == pytest.approx(k1, rel=0.03)  # measured 1 %: it is linearised at none
    assert 0 < sigma < 1e-5


@pytest.mark.parametrize("k1", [0.0, 0.005])
def test_as_uncertain_as_it_says(camera, two_views, k1):
    found, sigma = measured(camera, two_views, k1, noise=0.2, pairs=40)
    assert abs(found - k1) < 3 * sigma
    assert 0.0005 < sigma < 0.002  # measured 0.0011


def test_it_shows_in_turns(camera, two_views):
    (_, straight), (_, turning) = (measured(camera, two_views, 0.0, 0.2, 20, turn) for turn in (0.0, 0.05))
    assert straight > 2.5 * turning  # measured 4


def test_a_recording():
    """Bent and undistorted again."""
    flight = open_sequence("synthetic:uav?frames=20")
    k1, sigma = measure_distortion(flight.undistorted(-0.02))
    assert abs(k1 - 0.02) < 4 * sigma
    assert 0.0005 < sigma < 0.005


def test_a_camera_that_stands_still():
    still = open_sequence("synthetic:uav?frames=5")
    with pytest.raises(EstimationError, match="has not moved enough to tell its distortion"):
        measure_distortion(replace(still, load=lambda _: still.load(0)))
