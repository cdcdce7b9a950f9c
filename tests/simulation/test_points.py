"""The point-level simulator."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.simulation.points import PointScene, simulate, simulate_drive, simulate_flight, within
from fvslam_graph.simulation.worlds.drive import drive_motion

CAMERA = Camera(640, 480, 500, 500, 319.5, 239.5)
SCENES = pytest.mark.parametrize("make", [simulate_drive, simulate_flight])


def sideways(frames: int = 20) -> Trajectory:
    poses = tuple(gtsam.Pose3(gtsam.Rot3.Ry(0.01 * k), np.array([0.3 * k, 0, 0])) for k in range(frames))
    return Trajectory(np.arange(frames) / 10, poses)


@SCENES
def test_pixels_without_noise_are_exact_projections(make) -> None:
    scene: PointScene = make(frames=30, landmarks=3000)
    for frame in (0, 13, 29):
        seen = scene.observe(frame)
        points = scene.trajectory.poses[frame].transformTo(scene.landmarks[seen.ids].T).T
        assert len(seen.ids) > 100
        assert points[:, 2].min() > 0.5
        np.testing.assert_allclose(seen.pixels, scene.camera.project(points), atol=1e-8)
        assert not seen.is_outlier.any()
        assert np.all((seen.pixels >= 0) & (seen.pixels <= (scene.camera.width - 1, scene.camera.height - 1)))


@SCENES
def test_matches_fulfil_the_epipolar_constraint_of_the_true_motion(make) -> None:
    scene: PointScene = make(frames=30, landmarks=3000)
    matches = scene.match(10, 14)
    a_T_b = scene.trajectory.poses[10].between(scene.trajectory.poses[14])
    E = gtsam.EssentialMatrix(a_T_b.rotation(), gtsam.Unit3(a_T_b.translation())).matrix()
    rays_a, rays_b = (
        np.column_stack([scene.camera.normalize(pixels), np.ones(len(matches.ids))])
        for pixels in (matches.pixels_a, matches.pixels_b)
    )
    assert len(matches.ids) > 100
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", rays_a, E, rays_b), 0, atol=1e-12)


def test_a_frame_is_the_same_however_often_and_in_whatever_order_it_is_asked_for() -> None:
    first, second = (simulate_drive(frames=20, noise=0.5, outliers=0.1, life=10, seed=4) for _ in range(2))
    first.observe(3), first.match(2, 9)
    for frame in (7, 3):
        for a, b in zip(first.observe(frame), second.observe(frame), strict=True):
            np.testing.assert_array_equal(a, b)
    other = simulate_drive(frames=20, noise=0.5, outliers=0.1, life=10, seed=5)
    assert not np.array_equal(first.observe(3).ids, other.observe(3).ids)


def test_a_match_holds_the_pixels_of_both_frames() -> None:
    scene = simulate_flight(frames=20, noise=0.5, outliers=0.2)
    matches, seen = scene.match(5, 8), scene.observe(8)
    assert np.all(np.diff(matches.ids) > 0)
    rows = np.searchsorted(seen.ids, matches.ids)
    np.testing.assert_array_equal(matches.pixels_b, seen.pixels[rows])
    assert set(matches.ids) == set(scene.observe(5).ids) & set(seen.ids)
    assert matches.is_outlier.mean() == pytest.approx(1 - 0.8**2, abs=0.06)


def test_noise_has_its_standard_deviation_and_is_new_in_every_frame() -> None:
    clean, noisy = (simulate_flight(frames=20, landmarks=4000, noise=noise) for noise in (0.0, 0.7))
    a, b = (noisy.match(4, 5), clean.match(4, 5))
    errors = np.hstack([a.pixels_a - b.pixels_a, a.pixels_b - b.pixels_b])
    assert len(errors) > 500
    assert errors.std() == pytest.approx(0.7, rel=0.05)
    assert abs(errors.mean()) < 0.04
    correlations = np.corrcoef(errors.T) - np.eye(4)
    assert np.abs(correlations).max() < 0.12


def test_outliers_are_anywhere_and_marked() -> None:
    clean, spoilt = (simulate_drive(frames=10, outliers=share) for share in (0.0, 0.3))
    truth, seen = clean.observe(6), spoilt.observe(6)
    np.testing.assert_array_equal(truth.ids, seen.ids)
    errors = np.linalg.norm(truth.pixels - seen.pixels, axis=1)
    assert seen.is_outlier.mean() == pytest.approx(0.3, abs=0.04)
    assert errors[~seen.is_outlier].max() == 0
    assert np.median(errors[seen.is_outlier]) > 200


def test_landmarks_live_as_long_as_told() -> None:
    def sightings(life: int | None) -> np.ndarray:
        scene = simulate_drive(frames=60, landmarks=3000, life=life)
        seen = np.zeros((60, 3000), bool)
        for frame in range(60):
            seen[frame, scene.observe(frame).ids] = True
        return seen

    seen = sightings(life=8)
    assert seen.sum(axis=0).max() == 8
    frames = np.where(seen, np.arange(60)[:, None], np.nan)[:, seen.any(axis=0)]
    assert np.nanmax(np.nanmax(frames, axis=0) - np.nanmin(frames, axis=0)) == 7
    per_frame = seen.sum(axis=1)[8:-8]
    assert 50 < per_frame.max() < 2 * per_frame.min()  # as many in late frames as in early ones
    assert sightings(life=None).sum(axis=0).max() > 20


def test_many_landmarks_of_the_drive_are_on_the_road_and_none_below() -> None:
    scene = simulate_drive(frames=40, seed=2)
    start = drive_motion(2, 4.0).pose(0.0)
    heights = start.transformFrom(scene.landmarks.T)[2]
    on_road = np.abs(heights) < 1e-9
    assert 0.2 < on_road.mean() < 0.7
    assert heights.min() > -1e-9
    np.testing.assert_array_equal(scene.ground.heights, 1.65)


def test_landmarks_of_the_flight_scatter_about_the_mean_plane() -> None:
    scene = simulate_flight(frames=40, landmarks=3000)
    depths = scene.in_camera(20)[scene.observe(20).ids][:, 2]
    assert np.median(depths) == pytest.approx(scene.ground.heights[20], rel=0.08)
    oblique = simulate_flight(frames=40, landmarks=3000, view="oblique")
    assert np.median(oblique.in_camera(20)[oblique.observe(20).ids][:, 2]) > 1.2 * np.median(depths)


def test_any_trajectory_has_landmarks_in_view_between_the_depths() -> None:
    scene = simulate(sideways(), CAMERA, within(4, 40), landmarks=2000)
    assert len(scene) == 20
    for frame in (0, 10, 19):
        depths = scene.in_camera(frame)[scene.observe(frame).ids][:, 2]
        assert len(depths) > 300
        assert 3 < depths.min() < 6
        assert 30 < depths.max() < 45
    near = simulate(sideways(), CAMERA, within(4, 40), landmarks=2000, reach=10)
    assert near.in_camera(10)[near.observe(10).ids][:, 2].max() < 10


@pytest.mark.parametrize(
    "bad", [{"landmarks": 0}, {"noise": -1}, {"noise": float("nan")}, {"outliers": 1.1}, {"life": 0}]
)
def test_numbers_out_of_range_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(SequenceError, match="point scene"):
        simulate(sideways(), CAMERA, within(4, 40), **bad)
    with pytest.raises(SequenceError, match="point scene"):
        simulate(sideways(0), CAMERA, within(4, 40))
