"""Landmarks in rendered images."""

import numpy as np
import pytest

from fvslam_graph.core.config import FeatureSettings, SlamSettings
from fvslam_graph.core.landmark_finder import Search
from fvslam_graph.simulation.synthetic import synthetic_sequence
from fvslam_graph.slam.patch_finder import PatchFinder

DISTANCE = 20.0  # metres, about the height of the flight


@pytest.fixture(scope="module")
def flight():
    return synthetic_sequence("uav", frames=4)


@pytest.fixture
def begun(flight):
    finder = PatchFinder(flight.camera, FeatureSettings(), SlamSettings())
    frame = flight.frame(0)
    pixels = finder.candidates(frame, np.empty((0, 2)))[::4]
    pixels = pixels[flight.camera.contains(pixels, 60)]
    finder.remember(frame, np.arange(len(pixels)), pixels, flight.ground_truth.poses[0])
    return finder, pixels


def test_candidates_are_away_from_what_is_taken(flight, begun):
    finder, pixels = begun
    candidates = finder.candidates(flight.frame(0), pixels)
    assert len(candidates) > 20
    assert np.linalg.norm(candidates[:, None] - pixels, axis=2).min() >= FeatureSettings().spacing


def test_found_where_they_are(flight, begun):
    """In the next image, where the ground is known only to 30 % of its distance."""
    finder, pixels = begun
    camera, poses = flight.camera, flight.ground_truth.poses
    height = flight.ground.heights[0]
    inverse_depth = np.column_stack([camera.normalize(pixels), np.ones(len(pixels))])
    there = poses[1].transformTo((1.15 * height * inverse_depth).T).T
    expected = camera.project(there)
    visible = camera.contains(expected, 20)
    search = Search(
        np.arange(len(pixels))[visible],
        expected[visible],
        np.tile(20.0**2 * np.eye(2), (visible.sum(), 1, 1)),
        np.full((visible.sum(), 2), np.nan),
        there[visible],
        poses[1],
    )
    found_at, found = finder.find(flight.frame(1), search)
    assert found.mean() > 0.8
    true = camera.project(poses[1].transformTo((height * inverse_depth[visible]).T).T)
    off = np.linalg.norm(found_at - true, axis=1)[found]
    assert 0.01 < np.median(off) < 8.0  # the terrain has hills; measured 3 pixels


def test_what_odometry_follows_is_aligned_from_there(flight, begun):
    """However far off it was expected, and to the reference patch: where odometry has drifted, that is taken back."""
    finder, pixels = begun
    count, pose = len(pixels), flight.ground_truth.poses[0]
    followed = pixels + np.array([1.2, -0.8])
    followed[0] = pixels[0] + (9.0, 9.0)  # this one is not there
    points = DISTANCE * np.column_stack([flight.camera.normalize(pixels), np.ones(count)])
    far_off, tiny = pixels + 100, np.tile(np.eye(2), (count, 1, 1))
    at, found = finder.find(flight.frame(0), Search(np.arange(count), far_off, tiny, followed, points, pose))
    assert found[1:].all() and not found[0]
    assert np.abs(at[1:] - pixels[1:]).max() < 0.1


def test_forgotten_landmarks_are_gone(flight, begun):
    finder, pixels = begun
    finder.forget(np.array([1, 3]))
    search = Search(
        np.array([3]),
        pixels[[3]],
        np.eye(2)[None],
        np.full((1, 2), np.nan),
        np.array([[0, 0, DISTANCE]]),
        flight.ground_truth.poses[0],
    )
    at, found = finder.find(flight.frame(0), search)
    assert found.all() and at == pytest.approx(pixels[[3]], abs=0.02)


def test_nothing_is_found_in_the_dark(flight, begun):
    finder, pixels = begun
    dark = flight.frame(1)
    dark.image[:] = 3
    points = np.tile([0.0, 0.0, DISTANCE], (len(pixels), 1))
    spread = np.tile(25.0 * np.eye(2), (len(pixels), 1, 1))
    search = Search(
        np.arange(len(pixels)), pixels, spread, np.full(pixels.shape, np.nan), points, flight.ground_truth.poses[0]
    )
    _, found = finder.find(dark, search)
    assert not found.any()
    assert len(finder.candidates(dark, pixels)) == 0
