"""Odometry's eyes on a simulated scene."""

from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.core.tracks import Tracks
from fvslam_graph.simulation.points import frame_number, simulate_drive
from fvslam_graph.simulation.scene_tracker import SceneTracker


@pytest.fixture(scope="module")
def scene():
    return simulate_drive(frames=20, seed=1, noise=0.0, landmarks=6000)


@pytest.mark.parametrize("index", [0, 7, 19])
def test_images_tell_their_number(scene, index):
    assert frame_number(scene.sequence("points").frame(index).image) == index


def test_points_are_followed_exactly(scene):
    tracker, recording = SceneTracker(scene, 100), scene.sequence("points")
    assert len(tracker.track(recording.frame(0).image)) == 0
    points = tracker.set_keyframe(recording.frame(0).image, Tracks.none())
    assert len(points) == 100
    tracks = tracker.track(recording.frame(2).image)
    assert 50 < len(tracks) < 100  # some have left the view
    exact = scene.camera.project(scene.in_camera(2)[tracks.ids])
    assert tracks.current == pytest.approx(exact, abs=1e-9)
    kept = tracks[np.arange(30)]
    again = tracker.set_keyframe(recording.frame(2).image, kept)
    assert len(again) == 100 and len(np.unique(again.ids)) == 100
    assert again.ids[:30].tolist() == kept.ids.tolist()


def test_a_track_that_has_drifted_follows_what_is_there(scene):
    tracker, recording = SceneTracker(scene, 100), scene.sequence("points")
    points = tracker.set_keyframe(recording.frame(0).image, Tracks.none())
    drifted = replace(points, current=points.current + np.array([2.0, -1.0]))
    tracker.set_keyframe(recording.frame(0).image, drifted)
    tracks = tracker.track(recording.frame(4).image)
    assert tracks.keyframe == pytest.approx(drifted.current[np.isin(points.ids, tracks.ids)])
    depths = scene.in_camera(0)[tracks.ids, 2]
    there = depths[:, None] * np.column_stack([scene.camera.normalize(tracks.keyframe), np.ones(len(tracks))])
    moved = scene.trajectory.poses[0].between(scene.trajectory.poses[4])
    assert tracks.current == pytest.approx(scene.camera.project(moved.transformTo(there.T).T), abs=1e-9)


def test_wrong_matches(scene):
    tracker, recording = SceneTracker(scene, 300, wrong=0.3), scene.sequence("points")
    tracker.set_keyframe(recording.frame(0).image, Tracks.none())
    tracks = tracker.track(recording.frame(1).image)
    off = np.linalg.norm(tracks.current - scene.camera.project(scene.in_camera(1)[tracks.ids]), axis=1)
    assert 0.2 < np.mean(off > 5) < 0.4
