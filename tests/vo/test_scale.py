"""Metres per baseline: what each source does, and how it is put together with the map."""

import math

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.choices import ScaleSource
from fvslam_graph.core.config import ScaleSettings
from fvslam_graph.core.gaussian_pose import LogScale
from fvslam_graph.core.inverse_depths import InverseDepths, MetricMap
from fvslam_graph.core.sequence import Frame
from fvslam_graph.vo.depth import MIN_COMMON, triangulate
from fvslam_graph.vo.epipolar import MatchedRays
from fvslam_graph.vo.ground_plane import GroundPlane
from fvslam_graph.vo.relative_pose import RelativePose, TwoViews
from fvslam_graph.vo.scale import ORACLE_VARIANCE, MetricScale

MOTION = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.02, -0.03, 0.05])), np.array([0.9, -0.3, 1.2]))
BASELINE = float(np.linalg.norm(MOTION.translation()))
HEIGHT = 1.65
FALLBACK = LogScale(math.log(7.0), 1.0)
GREY = np.zeros((480, 640), np.uint8)


class Plumb:
    """A ground that is always seen as given."""

    def __init__(self, baseline_per_height: float, log_variance: float, roughness: float = 1.0) -> None:
        self.answer = GroundPlane(np.array([0.0, baseline_per_height, 0.0]), log_variance, 100, roughness, np.zeros(2))
        self.expected: list[float | None] = []

    def measure(self, views, expected, rng) -> GroundPlane | None:
        self.expected.append(expected)
        return self.answer


@pytest.fixture
def world(camera, two_views):
    """Two views, their depths in baselines, and the true depths as a map with a scale variance."""
    scene = two_views(MOTION)
    tracks, length = scene.tracks, np.linalg.norm(MOTION.translation())
    inliers, direction = np.ones(len(tracks), bool), MOTION.translation() / length
    relative_pose = RelativePose(
        MOTION.rotation(), direction, np.eye(5), inliers, np.zeros((len(inliers), 2)), 0.3, np.zeros((5, 2))
    )
    ray = camera.rays(tracks.keyframe)
    unit = triangulate(
        tracks.ids,
        MatchedRays(ray, camera.rays(tracks.current), camera.fx),
        MOTION.rotation(),
        relative_pose.direction,
    )
    depths = 1 / scene.points[:, 2]
    known = MetricMap(InverseDepths.independent(tracks.ids, depths, 0.01 * depths), 0.02**2)
    return relative_pose, ray, unit, known


def estimate(world, source: str, known=None, height=HEIGHT, aligner=None, true_baseline=None, **settings):
    relative_pose, ray, unit, everything = world
    scale = MetricScale(ScaleSettings(source=ScaleSource(source), **settings), aligner, true_baseline)
    step, metric_map = scale.estimate(
        TwoViews(Frame(3, 0.3, GREY, height), Frame(5, 0.5, GREY, height), relative_pose, ray, unit),
        everything if known is None else known,
        FALLBACK,
        np.random.default_rng(0),
    )
    return step.length, metric_map


def test_map_carries_the_scale_exactly(world):
    scale, learnt = estimate(world, "map", map_sigma=0.005)
    assert scale.metres == pytest.approx(BASELINE, rel=1e-9)
    # Its variance: of the map, what is added a keyframe, and nothing else where all points agree.
    assert scale.variance == pytest.approx(0.02**2 + 0.005**2, rel=1e-6)
    assert learnt.variance == scale.variance
    assert learnt.depths.values == pytest.approx(world[3].depths.values, rel=1e-9)
    assert np.all(learnt.depths.sigmas < world[3].depths.sigmas)


def test_map_with_wrong_points(world):
    _, _, _, known = world
    values = known.depths.values.copy()
    values[::4] *= 3.0  # a quarter of the points are something else
    wrong = MetricMap(InverseDepths.independent(known.depths.ids, values, known.depths.sigmas), known.variance)
    scale, _ = estimate(world, "map", known=wrong)
    assert scale.metres == pytest.approx(BASELINE, rel=0.01)  # measured
    assert abs(scale.metres / BASELINE - 1) > 1e-9


def test_new_points_join_the_map(world):
    _, _, unit, known = world
    some = MetricMap(known.depths[np.arange(100)], known.variance)
    _, learnt = estimate(world, "map", known=some)
    assert sorted(learnt.depths.ids) == sorted(unit.ids)
    order = np.argsort(learnt.depths.ids)
    assert learnt.depths.values[order] == pytest.approx(known.depths.values[np.argsort(unit.ids)], rel=1e-6)


def test_too_few_common_points_fall_back(world):
    known = world[3]
    few = MetricMap(known.depths[np.arange(MIN_COMMON - 1)], known.variance)
    for nearly_nothing in (few, MetricMap.empty()):
        scale, learnt = estimate(world, "map", known=nearly_nothing)
        assert scale == FALLBACK
        assert learnt.variance == FALLBACK.variance
        assert len(learnt) == len(known)


def test_unit(world):
    scale, learnt = estimate(world, "unit")
    assert scale.metres == 1.0
    assert learnt.depths.values == pytest.approx(world[2].values, rel=1e-9)


def test_oracle(world):
    asked = []

    def distance(a: int, b: int) -> float:
        asked.append((a, b))
        return 2.5

    scale, learnt = estimate(world, "oracle", true_baseline=distance)
    assert asked == [(3, 5)]
    assert scale == LogScale(math.log(2.5), ORACLE_VARIANCE)
    assert learnt.depths.values == pytest.approx(world[2].values / 2.5, rel=1e-9)


@pytest.mark.parametrize("answer", [math.nan, 0.0])
def test_oracle_without_an_answer(world, answer):
    scale, _ = estimate(world, "oracle", true_baseline=lambda a, b: answer)
    assert scale.metres == pytest.approx(BASELINE)  # the map's


def test_plane_and_map_are_fused(world):
    plumb = Plumb(1.1 * BASELINE / HEIGHT, 0.01**2)
    scale, learnt = estimate(world, "plane", aligner=plumb, plane_sigma=0.03, bias_sigma=0.04, map_sigma=1e-9)
    predicted, seen = 1 / 0.02**2, 1 / (0.01**2 + 0.03**2 + 0.04**2)  # information
    assert scale.mean == pytest.approx(math.log(BASELINE) + math.log(1.1) * seen / (predicted + seen), rel=1e-6)
    assert scale.variance == pytest.approx(1 / (predicted + seen), rel=1e-6)
    assert plumb.expected == [pytest.approx(BASELINE / HEIGHT)]
    # What is learnt about the scale holds for all points.
    assert learnt.depths.values == pytest.approx(world[3].depths.values * BASELINE / scale.metres, rel=1e-6)


def test_plane_alone(world):
    plumb = Plumb(BASELINE / HEIGHT, 0.01**2)
    scale, _ = estimate(world, "plane", known=MetricMap.empty(), aligner=plumb)
    assert scale.metres == pytest.approx(BASELINE, rel=0.01)  # pulled a little by the vague fallback
    assert scale.variance == pytest.approx(0.01**2 + 0.02**2 + 0.04**2, rel=0.01)
    assert plumb.expected == [None]  # so vague a prediction does not lead to the ground


def test_an_uncertain_height_makes_an_uncertain_scale(world):
    relative_pose, ray, unit, _ = world
    metric = MetricScale(ScaleSettings(), Plumb(BASELINE / HEIGHT, 0.0), None)
    frames = [Frame(i, float(i), GREY, HEIGHT, height_sigma=0.1 * HEIGHT) for i in range(2)]
    step, _ = metric.estimate(
        TwoViews(*frames, relative_pose, ray, unit), MetricMap.empty(), LogScale(0.0, 1e6), np.random.default_rng(0)
    )
    assert step.length.variance == pytest.approx(0.1**2 + 0.02**2 + 0.04**2, rel=1e-3)
    assert step.measured is not None and step.measured.variance == pytest.approx(0.1**2 + 0.02**2)
    assert step.bias_variance == pytest.approx(0.04**2)


@pytest.mark.parametrize(("height_sigma", "share"), [(0.0, 1.0), (0.2, 0.1)])
def test_smooth_ground_is_nearly_the_plane(world, height_sigma, share):
    """For a smoother only where the height says how sure it is."""
    relative_pose, ray, unit, _ = world
    metric = MetricScale(ScaleSettings(), Plumb(BASELINE / HEIGHT, 0.0, 0.1), None)
    frames = [Frame(i, float(i), GREY, HEIGHT, height_sigma=height_sigma) for i in range(2)]
    step, _ = metric.estimate(
        TwoViews(*frames, relative_pose, ray, unit), MetricMap.empty(), LogScale(0.0, 1e6), np.random.default_rng(0)
    )
    height = (height_sigma / HEIGHT) ** 2
    assert step.length.variance == pytest.approx(height + 0.002**2 + 0.004**2, rel=1e-3)
    assert step.measured is not None and step.measured.variance == pytest.approx(height + (share * 0.02) ** 2)
    assert step.bias_variance == pytest.approx((share * 0.04) ** 2)


@pytest.mark.parametrize("height", [math.nan, 0.0, -1.0])
def test_plane_without_a_height(world, height):
    plumb = Plumb(99.0, 0.0)
    assert estimate(world, "plane", height=height, aligner=plumb)[0].metres == pytest.approx(BASELINE)
    assert plumb.expected == []


def test_plane_that_is_not_seen(world):
    plumb = Plumb(99.0, 0.0)
    plumb.answer = None
    assert estimate(world, "plane", aligner=plumb)[0].metres == pytest.approx(BASELINE)
    assert len(plumb.expected) == 1
