"""Relative pose of two views: exact without noise, and as uncertain as it says with noise."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.stats import chi2

from fvslam_graph.core.config import VoSettings
from fvslam_graph.core.inverse_depths import InverseDepths
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.evaluation.nees import nees_band
from fvslam_graph.vo.depth import triangulate
from fvslam_graph.vo.epipolar import MatchedRays, calibration_jacobian, epipolar_distance
from fvslam_graph.vo.relative_pose import estimate_relative_pose

from .conftest import recalibrated

SETTINGS = VoSettings()
FORWARD = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.01, 0.03, -0.02])), np.array([0.2, 0.05, 1.0]))
SIDEWAYS = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.02, -0.01, 0.1])), np.array([1.0, 0.1, 0.1]))
MOTIONS = pytest.mark.parametrize("motion", [FORWARD, SIDEWAYS], ids=["forward", "sideways"])


def essential(pose: gtsam.Pose3) -> gtsam.EssentialMatrix:
    return gtsam.EssentialMatrix(pose.rotation(), gtsam.Unit3(pose.translation()))


def error_of(estimate, motion: gtsam.Pose3) -> np.ndarray:
    """In the tangent of the estimate, (5,) radians."""
    return gtsam.EssentialMatrix(estimate.rotation, gtsam.Unit3(estimate.direction)).localCoordinates(essential(motion))


@MOTIONS
def test_exact_without_noise(camera, two_views, motion):
    scene = two_views(motion)
    estimate = estimate_relative_pose(scene.tracks, camera, SETTINGS, seed=0)
    assert estimate.inliers.all() and len(estimate.inliers) == len(scene.tracks) > 250
    assert np.abs(error_of(estimate, motion)).max() < 1e-9  # measured 1e-15
    assert estimate.direction == pytest.approx(motion.translation() / np.linalg.norm(motion.translation()), abs=1e-9)


@MOTIONS
def test_epipolar_distance_is_that_of_the_textbook(camera, two_views, motion):
    """It is that of the point from the line F^T x (Hartley and Zisserman, section 11.4.3), in pixels."""
    tracks = two_views(motion, noise=2.0).tracks
    K_inverse = np.linalg.inv(camera.K)
    t = motion.translation() / np.linalg.norm(motion.translation())
    skew = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    F = K_inverse.T @ skew @ motion.rotation().matrix() @ K_inverse
    ones = np.ones((len(tracks), 1))
    previous, current = np.hstack([tracks.keyframe, ones]), np.hstack([tracks.current, ones])
    line = previous @ F
    expected = (current * line).sum(axis=1) / np.linalg.norm(line[:, :2], axis=1)
    seen = MatchedRays(camera.rays(tracks.keyframe), camera.rays(tracks.current), camera.fx)
    distance, _ = epipolar_distance(seen, motion.rotation(), t)
    assert np.abs(distance) == pytest.approx(np.abs(expected), rel=1e-9, abs=1e-9)
    assert 1.0 < distance.std() < 5.0
    # Half of a displacement that is four times as uncertain along x is seen in lines across it, none in those along it.
    stretched = np.tile(np.diag([4.0, 1.0]), (len(tracks), 1, 1))
    shorter, _ = epipolar_distance(replace(seen, covariances=stretched), motion.rotation(), t)
    across = line[:, :2] / np.linalg.norm(line[:, :2], axis=1, keepdims=True)
    assert shorter * np.sqrt(1 + 3 * across[:, 0] ** 2) == pytest.approx(distance)


@MOTIONS
def test_epipolar_jacobian_by_finite_differences(camera, two_views, motion):
    """Also far from the line, where a Jacobian that takes the line's normal as given is wrong."""
    tracks = two_views(motion, noise=5.0).tracks
    seen = MatchedRays(camera.rays(tracks.keyframe), camera.rays(tracks.current), camera.fx)

    def distances(step: np.ndarray) -> np.ndarray:
        moved = essential(motion).retract(step)
        return epipolar_distance(seen, moved.rotation(), moved.direction().point3())[0]

    direction = essential(motion).direction().point3()
    _, jacobian = epipolar_distance(seen, motion.rotation(), direction)
    step = 1e-6
    numeric = np.column_stack([(distances(step * e) - distances(-step * e)) / (2 * step) for e in np.eye(5)])
    assert np.abs(jacobian - numeric).max() < 1e-6 * np.abs(numeric).max()
    assert np.linalg.matrix_rank(jacobian) == 5


@MOTIONS
@pytest.mark.parametrize("number", range(7))
def test_calibration_jacobian_by_finite_differences(camera, two_views, motion, number):
    """Against how far a point has to go, in the image as it is, for its true ray to meet the plane of the other one."""
    tracks, step = two_views(motion, noise=0.5).tracks, 1e-6
    seen = MatchedRays(camera.rays(tracks.keyframe), camera.rays(tracks.current), camera.fx)
    E = gtsam.SO3.Hat(essential(motion).direction().point3()) @ motion.rotation().matrix()

    def true(ray: np.ndarray, change: float) -> np.ndarray:
        (x, y), r = ray[:, :2].T, (ray[:, :2] ** 2).sum(axis=1)
        off = [
            (x, y),
            (r * x, r * y),
            (r * r * x, r * r * y),
            (np.ones_like(x), np.zeros_like(x)),
            (np.zeros_like(x), np.ones_like(x)),
            (2 * x * y, r + 2 * y * y),
            (r + 2 * x * x, 2 * x * y),
        ][number]
        return ray - change * np.column_stack([*off, np.zeros_like(x)])

    def distances(change: float) -> np.ndarray:
        line = true(seen.previous, change) @ E
        normal = np.column_stack(
            [line[:, :2] / np.linalg.norm(line[:, :2], axis=1, keepdims=True), np.zeros(len(line))]
        )
        gone = np.zeros(len(line))
        for _ in range(4):
            meets = (true(seen.current - gone[:, None] * normal, change) * line).sum(axis=1)
            gone += meets / np.linalg.norm(line[:, :2], axis=1)
        return camera.fx * gone

    jacobian = calibration_jacobian(seen, motion.rotation(), essential(motion).direction().point3())[:, number]
    numeric = (distances(step) - distances(-step)) / (2 * step)
    assert (
        np.abs(jacobian - numeric).max() < 1e-3 * np.abs(numeric).max()
    )  # measured 4e-5: bends are those of the point


def nees_of(camera, two_views, motion, seeds: int, **options: float) -> np.ndarray:
    values = []
    for seed in range(seeds):
        estimate = estimate_relative_pose(two_views(motion, seed=seed, **options).tracks, camera, SETTINGS, seed)
        error = error_of(estimate, motion)
        assert np.abs(estimate.covariance - estimate.covariance.T).max() == 0
        values.append(error @ np.linalg.solve(estimate.covariance, error))
    return np.array(values)


@MOTIONS
def test_covariance_is_consistent(camera, two_views, motion):
    values = nees_of(camera, two_views, motion, 100, noise=0.1)
    low, high = nees_band(5, len(values))
    assert low < values.mean() < 1.1 * high  # measured 5.6 and 5.2


@MOTIONS
def test_covariance_is_honest_among_outliers(camera, two_views, motion):
    """Mostly: now and then an outlier lies on its epipolar line and is believed."""
    values = nees_of(camera, two_views, motion, 100, noise=0.1, outliers=0.2)
    assert 3.6 < np.median(values) < 5.2  # of chi-square with 5 degrees of freedom: 4.35; measured 4.6 and 4.9
    assert 0.72 < np.mean(values < chi2.ppf(0.95, 5)) < 0.98  # measured 0.78 and 0.83


@MOTIONS
def test_covariance_where_the_noise_is_that_of_the_loss(camera, two_views, motion):
    """A third of the residuals is cut by the loss and some by the threshold: a little optimistic."""
    values = nees_of(camera, two_views, motion, 100, noise=0.3)
    assert nees_band(5, len(values))[0] < values.mean() < 8.5  # measured 7.3 and 6.5


def test_outliers_are_found(camera, two_views):
    scene = two_views(FORWARD, noise=0.1, outliers=0.2)
    estimate = estimate_relative_pose(scene.tracks, camera, SETTINGS, seed=0)
    assert 0.3 < scene.is_outlier.mean() < 0.4  # wrong in one image or the other
    assert estimate.inliers[~scene.is_outlier].mean() > 0.99
    assert estimate.inliers[scene.is_outlier].mean() < 0.06  # by chance on the epipolar line
    assert 1e-5 < np.abs(error_of(estimate, FORWARD)).max() < 0.005


@pytest.mark.parametrize("noise", [0.05, 0.2])
def test_the_noise_is_told_by_the_inliers(camera, two_views, noise):
    scene = two_views(FORWARD)
    error = noise * np.random.default_rng(0).standard_normal(scene.tracks.current.shape)
    tracks = replace(scene.tracks, current=scene.tracks.current + error)
    assert estimate_relative_pose(tracks, camera, SETTINGS, 0).noise == pytest.approx(noise, rel=0.1)


def test_the_same_seed_gives_the_same_bits(camera, two_views):
    tracks = two_views(FORWARD, noise=0.3, outliers=0.2).tracks
    first, again = (estimate_relative_pose(tracks, camera, SETTINGS, seed=7) for _ in range(2))
    assert np.array_equal(first.direction, again.direction)
    assert np.array_equal(first.rotation.matrix(), again.rotation.matrix())
    assert np.array_equal(first.covariance, again.covariance)


@pytest.mark.parametrize("seed", range(5))
def test_of_two_solutions_of_a_plane_the_map_chooses(camera, plane_scene, seed):
    """Noise often prefers the wrong one: what is known of the depths tells, and if it is nothing, what is expected."""
    scene, motion, other = plane_scene(seed)
    far_off = gtsam.Pose3(motion.rotation(), motion.translation() + np.array([0.02, -0.03, 0.02]))
    sigma = 0.03 / scene.points[:, 2]
    known = InverseDepths.independent(scene.tracks.ids, 1 / scene.points[:, 2], sigma)
    for expected in ([far_off], [far_off, other], [other]):
        estimate = estimate_relative_pose(scene.tracks, camera, SETTINGS, seed, expected, known)
        assert np.abs(error_of(estimate, motion)).max() < 0.06
        assert np.abs(error_of(estimate, other)).max() > 0.2


@pytest.mark.parametrize("seed", range(5))
def test_a_map_of_the_wrong_solution_is_refuted_once_images_tell(camera, plane_scene, seed):
    """Ground that is rough by 0.6 % looks plane by a short motion; by a longer one, it tells."""
    scene, motion, other = plane_scene(seed)
    rng = np.random.default_rng(seed)
    points = scene.points * (1 + 0.006 * rng.standard_normal((len(scene.points), 1)))

    def views(length: float) -> Tracks:
        moved = gtsam.Pose3(motion.rotation(), length * motion.translation())
        current = camera.project(moved.transformTo(points.T).T)
        return replace(scene.tracks, current=current + 0.1 * rng.standard_normal(current.shape))

    short, rays = scene.tracks, MatchedRays.of(camera, scene.tracks)
    direction = other.translation() / np.linalg.norm(other.translation())
    wrong = triangulate(short.ids, rays, other.rotation(), direction, 0.15)
    wrong = replace(wrong[wrong.values > 0], sigmas=0.02 * wrong.values[wrong.values > 0])
    agrees = gtsam.Pose3(other.rotation(), 2 * other.translation())
    estimate = estimate_relative_pose(views(2.0), camera, SETTINGS, seed, [agrees], wrong)
    assert estimate.refutes_depths
    assert np.abs(error_of(estimate, motion)).max() < 0.02
    right = InverseDepths.independent(short.ids, 1 / points[:, 2], 0.03 / points[:, 2])
    assert not estimate_relative_pose(views(2.0), camera, SETTINGS, seed, [agrees], right).refutes_depths
    # Where the images cannot tell, the map is not blamed.
    assert not estimate_relative_pose(short, camera, SETTINGS, seed, [other], wrong).refutes_depths


def test_of_two_solutions_of_a_plane_the_flatter_one_is_taken_where_nothing_is_known(camera, plane_scene):
    """By the image alone, noise would choose: without the expectation about depths, 16 of these 40 are wrong."""
    for seed in range(40):
        scene, motion, other = plane_scene(seed)
        estimate = estimate_relative_pose(scene.tracks, camera, SETTINGS, seed, [other, motion])
        assert np.abs(error_of(estimate, motion)).max() < 0.06
        assert np.abs(error_of(estimate, other)).max() > 0.2


def test_where_images_tell_two_solutions_hardly_apart_the_spread_says_so(camera):
    """A climb above a plane goes nearly along its normal: the two solutions are alike, and noise chooses."""
    normal = np.array([0.1, -0.15, 1.0]) / np.linalg.norm([0.1, -0.15, 1.0])
    motion = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.002, -0.001, 0.003])), np.array([0.001, 0.002, -0.03]))
    alone, spread = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        pixels = rng.uniform((8, 8), (camera.width - 9, camera.height - 9), (200, 2))
        rays = camera.rays(pixels)
        current = camera.project(motion.transformTo((rays / (rays @ normal)[:, None]).T).T)
        tracks = Tracks.alike(np.arange(200), pixels, current + 0.1 * rng.standard_normal((200, 2)))
        estimate = estimate_relative_pose(tracks, camera, SETTINGS, seed)
        error = error_of(estimate, motion)
        alone.append(error @ np.linalg.solve(estimate.covariance, error))
        spread.append(error @ np.linalg.solve(estimate.covariance + estimate.spread, error))
    assert np.median(alone) > 50  # measured 125
    assert np.median(spread) < 25  # measured 15; 5 would be honest: they lie along a curve


def test_an_edge_tells_nothing_along_itself(camera, two_views):
    """Half of the points slide along edges by up to 10 pixels, all the same way."""
    scene = two_views(SIDEWAYS, noise=0.1)
    rng = np.random.default_rng(0)
    count = len(scene.tracks)
    angle = rng.uniform(0, np.pi, count)
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    slides = rng.random(count) < 0.5
    current = scene.tracks.current + np.where(slides, rng.uniform(5, 10, count), 0.0)[:, None] * along
    covariances = np.eye(2) + np.where(slides, 1e3, 0.0)[:, None, None] * along[:, :, None] * along[:, None, :]
    blind = estimate_relative_pose(replace(scene.tracks, current=current), camera, SETTINGS, 0)
    told = estimate_relative_pose(replace(scene.tracks, current=current, covariances=covariances), camera, SETTINGS, 0)
    assert np.abs(error_of(told, SIDEWAYS)).max() < 0.01
    assert told.inliers.mean() > 0.95
    assert blind is None or blind.inliers.mean() < 0.7


def test_nothing_to_go_by(camera, two_views):
    tracks = two_views(FORWARD).tracks
    assert estimate_relative_pose(Tracks.none(), camera, SETTINGS, 0) is None
    assert estimate_relative_pose(tracks[np.arange(SETTINGS.min_inliers - 1)], camera, SETTINGS, 0) is None
    one_place = replace(tracks[np.zeros(50, int)], ids=np.arange(50))
    assert estimate_relative_pose(one_place, camera, SETTINGS, 0) is None
    rng = np.random.default_rng(0)
    anywhere = Tracks.alike(np.arange(40), rng.uniform(0, 480, (40, 2)), rng.uniform(0, 480, (40, 2)))
    assert estimate_relative_pose(anywhere, camera, SETTINGS, 0) is None


@pytest.mark.parametrize(("column", "change"), [(0, (1e-4, 0.0)), (1, (0.0, 1e-4))])
def test_the_pose_changes_with_the_calibration_as_it_says(camera, two_views, column, change):
    tracks = two_views(FORWARD, noise=0.1).tracks
    other = Tracks.alike(tracks.ids, *(recalibrated(camera, at, *change) for at in (tracks.keyframe, tracks.current)))
    before, after = (estimate_relative_pose(seen, camera, SETTINGS, 0) for seen in (tracks, other))
    first, second = (gtsam.EssentialMatrix(view.rotation, gtsam.Unit3(view.direction)) for view in (before, after))
    moved = first.localCoordinates(second) / max(change)
    assert before.J_calibration[:, column] == pytest.approx(moved, rel=0.1, abs=0.02)  # measured within 0.001
