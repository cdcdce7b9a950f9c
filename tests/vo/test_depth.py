"""Inverse depths: triangulated, put together and carried into another camera."""

from collections.abc import Callable

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.inverse_depths import COMMON_ERRORS, InverseDepths
from fvslam_graph.vo.depth import PIXEL_NOISE, ScaleRatio, scale_ratio, triangulate
from fvslam_graph.vo.epipolar import MatchedRays

MOTION = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.02, -0.03, 0.05])), np.array([0.6, -0.2, 0.5]))


def from_scene(camera, scene, motion=MOTION, current=None, covariance=None) -> InverseDepths:
    tracks = scene.tracks
    current = tracks.current if current is None else current
    return triangulate(
        tracks.ids,
        MatchedRays(camera.rays(tracks.keyframe), camera.rays(current), camera.fx),
        motion.rotation(),
        motion.translation(),
        covariance=covariance,
    )


def test_triangulation_is_exact(camera, two_views):
    scene = two_views(MOTION)
    depths = from_scene(camera, scene)
    assert depths.values == pytest.approx(1 / scene.points[:, 2], rel=1e-9)
    assert np.array_equal(depths.ids, scene.tracks.ids)


def test_the_baseline_is_the_unit(camera, two_views):
    scene = two_views(MOTION)
    length = np.linalg.norm(MOTION.translation())
    unit = from_scene(camera, scene, gtsam.Pose3(MOTION.rotation(), MOTION.translation() / length))
    metric = unit.scaled(length)
    assert metric.values == pytest.approx(1 / scene.points[:, 2], rel=1e-9)
    assert metric.sigmas == pytest.approx(unit.sigmas / length)


def test_sigmas_are_consistent(camera, two_views):
    scene = two_views(MOTION)
    true = 1 / scene.points[:, 2]
    normalized = []
    for seed in range(100):
        noise = PIXEL_NOISE * np.random.default_rng(seed).standard_normal(scene.tracks.current.shape)
        depths = from_scene(camera, scene, current=scene.tracks.current + noise)
        normalized.append((depths.values - true) / depths.sigmas)
    assert np.std(normalized) == pytest.approx(1.0, abs=0.05)
    assert np.std(normalized, axis=0) == pytest.approx(1.0, abs=0.35)  # of every point, whatever its parallax
    assert abs(np.mean(normalized)) < 0.03


def test_shared_errors_by_finite_differences(camera, two_views):
    scene, step = two_views(MOTION), 1e-6
    length = np.linalg.norm(MOTION.translation())
    essential = gtsam.EssentialMatrix(MOTION.rotation(), gtsam.Unit3(MOTION.translation()))

    def values(change: np.ndarray) -> np.ndarray:
        moved = essential.retract(change)
        return from_scene(camera, scene, gtsam.Pose3(moved.rotation(), length * moved.direction().point3())).values

    numeric = np.column_stack([(values(step * e) - values(-step * e)) / (2 * step) for e in np.eye(5)])
    mixing = 0.01 * np.random.default_rng(0).standard_normal((5, 5))
    depths = from_scene(camera, scene, covariance=mixing @ mixing.T)
    expected = numeric @ mixing @ mixing.T @ numeric.T
    assert depths.common @ depths.common.T == pytest.approx(expected, rel=1e-4, abs=1e-6 * expected.max())
    assert not from_scene(camera, scene).common.any()


def numerically_by_calibration(
    camera: Camera, values: Callable[[Camera, np.ndarray], np.ndarray], step: float = 1e-6
) -> np.ndarray:
    """How `values` of a camera change with its calibration (2,), by finite differences."""

    def at(change: np.ndarray) -> np.ndarray:
        return values(camera.corrected(np.concatenate([change, np.zeros(5)])), change)

    return np.column_stack([(at(step * e) - at(-step * e)) / (2 * step) for e in np.eye(2)])


def test_depths_by_another_calibration_by_finite_differences(camera, two_views):
    """With it the rays change, and with these the motion that two views tell."""
    scene = two_views(MOTION)
    unit = MOTION.translation() / np.linalg.norm(MOTION.translation())
    essential = gtsam.EssentialMatrix(MOTION.rotation(), gtsam.Unit3(unit))
    J_motion = np.random.default_rng(0).standard_normal((5, 2))

    def triangulated(seen: Camera, motion: gtsam.EssentialMatrix, **options) -> InverseDepths:
        rays = MatchedRays(seen.rays(scene.tracks.keyframe), seen.rays(scene.tracks.current), seen.fx)
        return triangulate(scene.tracks.ids, rays, motion.rotation(), motion.direction().point3(), **options)

    for J_calibration in (np.zeros((5, 2)), J_motion):
        found = triangulated(camera, essential, covariance=np.eye(5), J_calibration=J_calibration).J_calibration
        numeric = numerically_by_calibration(
            camera,
            lambda seen, change, J=J_calibration: triangulated(seen, essential.retract(J @ change)).values,
        )
        assert found == pytest.approx(numeric, rel=1e-4, abs=1e-5 * np.abs(numeric).max())


def test_parallax_the_wrong_way_is_a_negative_depth(camera):
    sideways, ahead = np.array([1.0, 0.0, 0.0]), np.array([[0.0, 0.0, 1.0]] * 2)
    moved = np.array([[-0.1, 0.0, 1.0], [0.1, 0.0, 1.0]])
    depths = triangulate(np.arange(2), MatchedRays(ahead, moved, camera.fx), gtsam.Rot3(), sideways)
    assert depths.values == pytest.approx([0.1, -0.1])


def test_no_depth_along_the_direction_of_travel(camera):
    ahead, forward = np.array([[0.0, 0.0, 1.0]]), np.array([0.0, 0.0, 1.0])
    depths = triangulate(np.arange(1), MatchedRays(ahead, ahead, camera.fx), gtsam.Rot3(), forward)
    assert np.isfinite(depths.values).all() and depths.sigmas[0] > 1e3


def test_fused_is_weighted_by_information():
    a = InverseDepths.independent(np.array([3, 1, 5]), np.array([0.3, 0.1, 0.5]), np.array([0.02, 0.01, 0.05]))
    b = InverseDepths.independent(np.array([5, 7, 1]), np.array([0.6, 0.7, 0.2]), np.array([0.05, 0.07, 0.03]))
    both = a.fused(b)
    known = {int(i): (value, sigma) for i, value, sigma in zip(both.ids, both.values, both.sigmas, strict=True)}
    assert sorted(known) == [1, 3, 5, 7]
    assert known[3] == (0.3, 0.02) and known[7] == (0.7, 0.07)
    assert known[5] == pytest.approx((0.55, 0.05 / 2**0.5))
    # Kalman: gain 0.01^2 / (0.01^2 + 0.03^2) = 0.1
    assert known[1] == pytest.approx((0.11, 0.01 * 0.9**0.5))


def test_what_is_shared_averages_out_with_the_rest():
    ids, values, sigmas = np.arange(3), np.full(3, 0.1), np.array([0.01, 0.02, 0.03])
    once = InverseDepths(ids, values, sigmas, np.ones((3, 5)), np.zeros((3, 2)))
    again = once.fused(once)
    assert again.sigmas == pytest.approx(sigmas / 2**0.5)
    assert again.common @ again.common.T == pytest.approx(once.common @ once.common.T / 2)


def test_what_is_no_longer_in_common_is_not_lost_where_both_know_a_point():
    rng = np.random.default_rng(0)
    common = 1e-2 * rng.standard_normal((40, 10))
    old = InverseDepths(np.arange(40), np.full(40, 0.1), np.full(40, 1e-3), common, np.zeros((40, 2)))
    new = InverseDepths(np.arange(40), np.full(40, 0.2), np.full(40, 1e-2), np.zeros((40, 5)), np.zeros((40, 2)))
    both = old.fused(new)
    own = old.compressed().sigmas
    weight = own**-2 / (own**-2 + 1e-2**-2)
    assert both.sigmas == pytest.approx((own**-2 + 1e-2**-2) ** -0.5)
    assert both.values == pytest.approx(0.1 * weight + 0.2 * (1 - weight))
    assert np.median(weight) < 0.5  # of what the newer one tells, ten errors in common leave little to the older


def test_of_errors_in_common_the_most_important_are_kept():
    rng = np.random.default_rng(0)
    common = rng.standard_normal((40, 10)) * np.geomspace(1e-2, 1e-4, 10)
    depths = InverseDepths(np.arange(40), np.full(40, 0.1), np.full(40, 1e-3), common, np.zeros((40, 2)))
    fewer = depths.compressed()
    assert fewer.common.shape == (40, COMMON_ERRORS)
    assert fewer.total_sigmas == pytest.approx(depths.total_sigmas)
    lost = common @ common.T - fewer.common @ fewer.common.T
    assert np.abs(lost).max() < 0.01 * np.abs(common @ common.T).max()
    assert fewer.compressed() is fewer


def test_fused_with_nothing():
    some = InverseDepths.independent(np.array([1, 2]), np.array([0.1, 0.2]), np.array([0.01, 0.02]))
    for both in (some.fused(InverseDepths.none()), InverseDepths.none().fused(some)):
        assert both.ids.tolist() == [1, 2] and both.values.tolist() == [0.1, 0.2]
    assert len(InverseDepths.none().fused(InverseDepths.none())) == 0


def test_common():
    depths = InverseDepths.independent(np.array([8, 2, 5]), np.array([0.8, 0.2, 0.5]), np.ones(3))
    ids = np.array([5, 9, 8, 1])
    mine, theirs = depths.match(ids)
    assert depths.ids[mine].tolist() == ids[theirs].tolist() == [5, 8]
    assert depths[mine].values.tolist() == [0.5, 0.8]


def test_moved_is_exact(camera, two_views):
    scene = two_views(MOTION)
    depths = InverseDepths.independent(scene.tracks.ids, 1 / scene.points[:, 2], np.full(len(scene.points), 0.01))
    moved = depths.seen_from(camera.rays(scene.tracks.keyframe), MOTION)
    in_new = MOTION.transformTo(scene.points.T).T
    assert np.array_equal(moved.ids, depths.ids)
    assert moved.values == pytest.approx(1 / in_new[:, 2], rel=1e-9)


def test_moved_sigmas_by_finite_differences(camera, two_views):
    scene = two_views(MOTION)
    ray, step = camera.rays(scene.tracks.keyframe), 1e-7
    values, sigmas = 1 / scene.points[:, 2], np.linspace(0.001, 0.01, len(scene.points))

    def moved(change: float) -> InverseDepths:
        common = np.outer(sigmas, np.arange(5))
        depths = InverseDepths(scene.tracks.ids, values + change, sigmas, common, np.zeros((len(values), 2)))
        return depths.seen_from(ray, MOTION)

    derivative = (moved(step).values - moved(-step).values) / (2 * step)
    assert moved(0).sigmas == pytest.approx(sigmas * np.abs(derivative), rel=1e-5)
    assert moved(0).common == pytest.approx(np.outer(sigmas * derivative, np.arange(5)), rel=1e-5)


def test_moved_by_a_motion_that_errs_by_finite_differences(camera, two_views):
    scene, step = two_views(MOTION), 1e-7
    ray, values = camera.rays(scene.tracks.keyframe), 1 / scene.points[:, 2]
    length = np.linalg.norm(MOTION.translation())
    essential = gtsam.EssentialMatrix(MOTION.rotation(), gtsam.Unit3(MOTION.translation()))
    depths = InverseDepths(
        scene.tracks.ids, values, 0.01 * values, np.zeros((len(values), 5)), np.zeros((len(values), 2))
    )

    def moved(change: np.ndarray) -> np.ndarray:
        motion = essential.retract(change)
        there = gtsam.Pose3(motion.rotation(), length * motion.direction().point3())
        return depths.seen_from(ray, there).values

    numeric = np.column_stack([(moved(step * e) - moved(-step * e)) / (2 * step) for e in np.eye(5)])
    found = depths.seen_from(ray, MOTION, np.eye(5)).common
    assert found == pytest.approx(numeric, rel=1e-4, abs=1e-6 * np.abs(numeric).max())


def test_moved_by_another_calibration_by_finite_differences(camera, two_views):
    scene, rng = two_views(MOTION), np.random.default_rng(0)
    values = 1 / scene.points[:, 2]
    J_depths, J_motion = 0.1 * rng.standard_normal((len(values), 2)), rng.standard_normal((6, 2))

    def moved(seen: Camera, change: np.ndarray) -> InverseDepths:
        depths = InverseDepths(
            scene.tracks.ids, values + J_depths @ change, values, np.zeros((len(values), 0)), J_depths
        )
        return depths.seen_from(seen.rays(scene.tracks.keyframe), MOTION.retract(J_motion @ change), None, J_motion)

    numeric = numerically_by_calibration(camera, lambda seen, change: moved(seen, change).values)
    found = moved(camera, np.zeros(2)).J_calibration
    assert found == pytest.approx(numeric, rel=1e-4, abs=1e-5 * np.abs(numeric).max())


def test_points_that_are_passed_are_dropped():
    ray = np.array([[0.0, 0.0, 1.0]] * 5)
    depths = InverseDepths.independent(
        np.arange(5), np.array([1 / 10, 1 / 2.5, 1 / 2.05, 1 / 1.5, -1 / 10]), np.full(5, 0.01)
    )
    moved = depths.seen_from(ray, gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 2.0])))
    assert moved.ids.tolist() == [0, 1]  # the third is 5 cm ahead, the fourth behind, the last never was in front
    assert moved.values == pytest.approx([1 / 8, 1 / 0.5])
    around = gtsam.Pose3(gtsam.Rot3.Ry(np.pi), np.zeros(3))
    assert len(depths.seen_from(ray, around)) == 0


def two_triangulations(seed: int, own: float, common: float, count: int = 100) -> tuple[InverseDepths, InverseDepths]:
    """New depths in baselines of 2 m and known ones, which err by these shares of the usual depth."""
    rng = np.random.default_rng(seed)
    true = rng.uniform(0.05, 0.3, count)
    x, y = rng.uniform(-1, 1, (2, count))
    errors = common * np.median(true) * np.column_stack([x, y, x**2 + y**2])
    found = []
    for length in (2.0, 1.0):
        sigmas = np.full(count, own * np.median(true) * length)
        values = length * (true + errors @ rng.standard_normal(3)) + sigmas * rng.standard_normal(count)
        found.append(InverseDepths(np.arange(count), values, sigmas, length * errors, np.zeros((count, 2))))
    return found[0], found[1]


def test_scale_ratio_is_exact():
    _, known = two_triangulations(0, 0.01, 0.05)
    ratio = scale_ratio(known.scaled(1 / 2), known)
    assert ratio is not None and ratio.scale.metres == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize("own", [0.01, 0.05, 0.2])
def test_scale_ratio_is_consistent(own):
    ratios = [scale_ratio(*two_triangulations(seed, own, 0.0)) for seed in range(300)]
    errors = np.array([ratio.scale.mean - np.log(2) for ratio in ratios if ratio])
    assert len(errors) == 300
    squares = errors**2 / [ratio.scale.variance for ratio in ratios if ratio]
    assert np.mean(squares) == pytest.approx(1.0, abs=0.35)  # one deviation is 0.08
    assert abs(np.mean(errors)) < 4 * np.std(errors) / np.sqrt(300)


def test_scale_ratio_by_another_calibration_by_finite_differences():
    new, known = two_triangulations(0, 0.02, 0.03)
    rng, step = np.random.default_rng(0), 1e-5
    J_new, J_known = (
        depths.values[:, None] * (share + 0.1 * rng.standard_normal((100, 2)))
        for depths, share in ((new, [1.0, -2.0]), (known, [0.5, 2.0]))
    )

    def ratio(change: np.ndarray) -> ScaleRatio:
        pair = (
            InverseDepths(depths.ids, depths.values + J @ change, depths.sigmas, depths.common, J)
            for depths, J in ((new, J_new), (known, J_known))
        )
        found = scale_ratio(*pair)
        assert found is not None
        return found

    numeric = [(ratio(step * e).scale.mean - ratio(-step * e).scale.mean) / (2 * step) for e in np.eye(2)]
    assert ratio(np.zeros(2)).J_calibration == pytest.approx(numeric, rel=0.05)  # weights change as well


def test_scale_ratio_does_not_follow_errors_in_common():
    """These make one side of the image nearer: what is left of them over the points is taken out."""

    def errors(forgotten: bool) -> float:
        found = []
        for seed in range(100):
            pair = two_triangulations(seed, 0.02, 0.03)
            if forgotten:
                pair = tuple(InverseDepths.independent(d.ids, d.values, d.sigmas) for d in pair)
            ratio = scale_ratio(*pair)
            assert ratio is not None
            found.append(ratio.scale.mean - np.log(2))
        return float(np.std(found))

    assert errors(forgotten=False) < 0.4 * errors(forgotten=True)


def test_scale_ratio_of_uncertain_depths_hardly_grows():
    """Depths that are too small by chance would have larger common errors, if these were a share of them."""
    errors = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        true, ids = rng.uniform(0.05, 0.3, 100), np.arange(100)
        common = 0.1 * np.median(true) * np.column_stack([*rng.uniform(-1, 1, (2, 100)), np.ones(100)])
        sigmas = np.full(100, 0.2 * np.median(true))
        new = true + common @ rng.standard_normal(3) + sigmas * rng.standard_normal(100)
        known = InverseDepths.independent(ids, true * (1 + 0.01 * rng.standard_normal(100)), 0.01 * true)
        ratio = scale_ratio(InverseDepths(ids, new, sigmas, common, np.zeros((100, 2))), known)
        assert ratio is not None
        errors.append(ratio.scale.mean)
    assert abs(np.mean(errors)) < 0.07  # measured -0.03, and 0.13 by a share of the depths as they are


@pytest.mark.parametrize("horizon", [0.0, 0.5, 0.9])
def test_a_horizon_does_not_make_unknown_points_far(horizon):
    rng = np.random.default_rng(0)
    near = rng.random(1000) >= horizon
    sigmas = rng.uniform(0.01, 0.03, 1000)
    values = np.where(near, 0.1, 0.0) + sigmas * rng.standard_normal(1000)
    depths = InverseDepths.independent(np.arange(1000), values, sigmas)
    assert 0.02 < depths.usual < 0.11  # root mean square: 0.1, 0.07 and 0.03
    assert 0.8 * near.sum() < depths.telling.sum() < near.sum() + 40
    unknown = depths.of(np.array([2000]))
    assert abs(0.1 - unknown.values[0]) < unknown.sigmas[0]
