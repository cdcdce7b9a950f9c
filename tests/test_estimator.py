"""The loop over the frames, on a short drive."""

import json
from dataclasses import replace
from functools import cache

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import load_config
from fvslam_graph.core.trajectory import Status
from fvslam_graph.estimator import estimate, frame_estimator, stages, through
from fvslam_graph.evaluation.monte_carlo import pose_errors, run
from fvslam_graph.evaluation.nees import nees
from fvslam_graph.evaluation.runs import evaluate_run
from fvslam_graph.pipeline import run_sequence
from fvslam_graph.runs.run_folder import GRAPH_FILES, METRICS_FILE
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.simulation.points import simulate_drive, simulate_flight
from fvslam_graph.simulation.synthetic import synthetic_sequence
from fvslam_graph.testing import rendered


@pytest.fixture
def sequence(drive):
    return open_sequence(drive)


def test_one_result_a_frame(sequence):
    results = list(estimate(sequence, load_config()))
    assert [result.index for result in results] == list(range(12))
    assert [result.stamp for result in results] == pytest.approx(sequence.stamps.tolist())
    assert results[0].pose.mean.equals(gtsam.Pose3(), 0)
    assert results[0].previous == 0
    for result in results[1:]:
        assert result.previous < result.index
        assert result.pose.mean.equals(results[result.previous].pose.mean * result.relative.mean, 1e-9)
        assert np.allclose(result.relative.covariance, result.relative.covariance.T)
        assert np.linalg.eigvalsh(result.relative.covariance)[0] > -1e-12
    assert {tuple(result.measures) for result in results} == {tuple(results[0].measures)}
    assert {tuple(result.times) for result in results} == {stages(load_config())}


def test_frames_are_read_when_they_are_asked_for(sequence):
    read = []

    def load(index):
        read.append(index)
        return sequence.load(index)

    results = estimate(replace(sequence, load=load), load_config())
    next(results)
    next(results)
    assert read == [0, 1]


@pytest.mark.parametrize("source", ["plane", "oracle"])
def test_metric_scale(sequence, source):
    results = list(estimate(sequence, load_config(settings=[f"scale.source={source}"])))
    travelled = np.linalg.norm(results[-1].pose.mean.translation())
    true = np.linalg.norm(sequence.ground_truth.positions[-1] - sequence.ground_truth.positions[0])
    assert travelled == pytest.approx(true, rel={"plane": 0.2, "oracle": 0.02}[source])
    assert travelled != pytest.approx(true, rel=1e-9)


def test_unit_scale(sequence):
    results = list(estimate(sequence, load_config(settings=["scale.source=unit"])))
    lengths = [np.linalg.norm(result.relative.mean.translation()) for result in results if result.measures["scale"] > 0]
    assert len(lengths) > 5 and np.allclose(lengths, 1)


def test_frames_without_image_are_skipped(sequence):
    lost = replace(sequence, load=lambda index: None if index in (0, 5) else sequence.load(index))
    results = list(estimate(lost, load_config()))
    assert [result.index for result in results if result.status is Status.SKIPPED] == [0, 5]
    assert len(results) == 12


def test_a_byte_identical_image_is_no_measurement(sequence):
    again = replace(sequence, load=lambda index: sequence.load(4 if index == 5 else index))
    results = list(estimate(again, load_config()))
    assert [result.index for result in results if result.status is Status.SKIPPED] == [5]
    moved = results[4].pose.mean.between(results[5].pose.mean).translation()
    assert np.linalg.norm(moved) > 0.3  # the motion model carries on
    assert np.trace(results[5].pose.covariance) > np.trace(results[4].pose.covariance)


@pytest.fixture(scope="module")
def flown():
    return rendered("uav", frames=24)


@pytest.fixture(scope="module")
def estimated(flown):
    """The results on the flight by the settings; runs that several tests look at are made once."""
    return cache(lambda *settings: list(estimate(flown, load_config(settings=settings))))


def test_visual_slam_starts_when_the_scale_is_known(flown, estimated):
    results = estimated("mode=vslam")
    assert [result.index for result in results] == list(range(24))
    started = next(result.index for result in results if result.slam is not None)
    assert started <= 3
    assert all(result.slam is not None for result in results[started:])
    assert {tuple(result.times) for result in results} == {stages(load_config(settings=["mode=vslam"]))}
    assert {tuple(result.measures) for result in results} == {tuple(results[0].measures)}
    assert np.isnan(results[-1].measures["tracks"]) and results[-1].measures["measured"] >= 20  # odometry has ended
    errors = [result.pose.mean.between(flown.ground_truth.poses[result.index]) for result in results]
    assert 0.01 < max(np.linalg.norm(error.translation()) for error in errors) < 1.0  # metres on 29 m; measured 0.4


def test_visual_slam_starts_where_the_first_map_is_beyond_doubt():
    """A slow flight: odometry has depths from its second motion on, but the more noise, the less is known of them."""
    started = []
    for noise in (2.0, 8.0):
        slow = synthetic_sequence("uav", frames=12, size="320x240", seed=3, noise=noise)
        results = list(estimate(slow, load_config(settings=["mode=average"])))
        started.append(next(result.index for result in results if result.slam is not None))
    assert started[0] < started[1]  # measured 2 and 6


def test_where_visual_slam_never_begins_the_run_says_so(caplog):
    short = synthetic_sequence("uav", frames=4, size="320x240", seed=3, noise=8.0)
    estimator = frame_estimator(short, load_config(settings=["mode=average"]))
    results = list(through(estimator, short))
    assert all(result.slam is None for result in results) and "never began" not in caplog.text
    estimator.finish()
    assert "never began" in caplog.text


@pytest.mark.parametrize("interleave", [1, 5])
def test_visual_slam_with_odometry_as_prior(flown, interleave):
    settings = ["mode=vslam", "slam.motion=odometry", f"slam.interleave={interleave}"]
    results = list(estimate(flown, load_config(settings=settings)))
    ran = [result.index for result in results if result.slam is not None]
    assert np.all(np.diff(ran) == interleave)
    assert {result.status for result in results[1:]} == {Status.TRACKED}
    assert all(result.measures["tracks"] > 0 for result in results[1:])
    for result in results[1:]:
        assert result.previous < result.index
        assert np.linalg.eigvalsh(result.pose.covariance)[0] > -1e-12
    error = results[-1].pose.mean.between(flown.ground_truth.poses[23])
    assert 0.005 < np.linalg.norm(error.translation()) < 1.0  # metres on 29 m; measured 0.1 and 0.2


def test_visual_slam_waits_for_a_scale(flown):
    """Without one it does not begin; where the scale is relative anyway, it does."""
    unknown = replace(flown, ground=replace(flown.ground, heights=np.full(24, np.nan)))
    results = list(estimate(unknown, load_config(settings=["mode=vslam", "scale.source=plane"])))
    assert all(result.slam is None for result in results)
    results = list(estimate(unknown, load_config(settings=["mode=vslam", "scale.source=map"])))
    assert results[-1].slam is not None


def test_the_same_seed_gives_the_same_bits(flown):
    config = load_config(settings=["mode=vslam"])
    first, second = (list(estimate(flown.select(stop=8), config)) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        assert np.array_equal(a.pose.mean.matrix(), b.pose.mean.matrix())
        assert np.array_equal(a.pose.covariance, b.pose.covariance)


def test_darkness_is_coasted_through(flown):
    """The motion goes on as it was, less and less certain; when it is light again, it is found in the map."""
    dark = np.zeros((480, 640), np.uint8)
    night = replace(flown, load=lambda index: dark if 10 <= index < 18 else flown.load(index))
    results = list(estimate(night, load_config(settings=["mode=vslam"])))
    statuses = [result.status for result in results]
    assert statuses[10:18] == [Status.COASTED] * 8
    assert set(statuses[18:]) == {Status.TRACKED}  # part of the map is still in view
    spread = [np.trace(result.pose.covariance[3:, 3:]) for result in results]
    assert np.all(np.diff(spread[9:18]) > 0)
    error = results[17].pose.mean.translation() - flown.ground_truth.positions[17]
    assert 0.05 < np.linalg.norm(error) < 2.0  # metres after 10 in the dark; measured 0.6
    assert np.linalg.norm(error) < 3 * np.sqrt(spread[17])


@pytest.mark.parametrize("mode", ["average", "intersection"])
def test_both_fused_at_every_fifth_frame(flown, estimated, mode):
    results = estimated(f"mode={mode}")
    ran = [result.index for result in results if result.slam is not None]
    assert np.all(np.diff(ran) == 5)
    assert {result.status for result in results[1:]} == {Status.TRACKED}
    for result in results[1:]:
        # What was measured across a fusion does not lead from one online pose to the next: they are re-anchored.
        if result.slam is not None or result.previous >= max((i for i in ran if i < result.index), default=0):
            assert result.pose.mean.equals(results[result.previous].pose.mean * result.relative.mean, 1e-9)
    fused = results[ran[1]]
    assert fused.previous == ran[0]  # the motion since the last fusion
    if mode == "average":  # the intersection may give all weight to the smaller covariance
        assert not fused.pose.mean.equals(fused.slam.pose.mean, 1e-6)
    error = results[-1].pose.mean.between(flown.ground_truth.poses[23])
    assert 0.005 < np.linalg.norm(error.translation()) < 0.5  # metres on 29 m; measured 0.1


def test_the_weight_leads_from_one_to_the_other(estimated):
    first, alone = estimated("mode=average", "fusion.weight=0"), estimated()
    for a, b in zip(first, alone, strict=True):
        assert a.pose.mean.equals(b.pose.mean, 1e-9)
    third = estimated("mode=average", "fusion.weight=1")
    index = [result.index for result in third if result.slam is not None][1]
    assert third[index].pose.mean.equals(third[index].slam.pose.mean, 1e-9)


def test_odometry_carries_on_alone_where_visual_slam_is_lost(estimated):
    """Too few matches over an interval: that fusion is left out, with a status that says so."""
    results = estimated("mode=average", "slam.min_matches=1000")
    ran = [result for result in results if result.slam is not None][1:]
    assert {result.status for result in ran} <= {Status.COASTED, Status.REINITIALISED}
    for a, b in zip(results, estimated(), strict=True):
        assert a.pose.mean.equals(b.pose.mean, 1e-9)


def test_a_shorter_interval_where_matches_are_few(flown):
    settings = ["mode=average", "slam.min_matches=1000", "slam.shorten=true"]
    results = list(estimate(flown, load_config(settings=settings)))
    intervals = [result.measures["interval"] for result in results if result.slam is not None]
    assert intervals[1:4] == [5, 2, 1]


@pytest.mark.parametrize("mode", ["vo", "average", "intersection", "graph"])
def test_any_mode_runs_on_simulated_points(mode):
    """Without images; with noise, errors are small, and not larger than the covariances allow."""
    scene = simulate_drive(frames=40, seed=3, noise=0.5, landmarks=6000)
    noise = ["vo.ransac_threshold=1", "slam.pixel_sigma=0.5", "graph.pixel_sigma=0.5"]  # as strong as it is
    settings = [f"mode={mode}", "scale.source=oracle", *noise]
    results = list(run(scene, load_config(settings=settings)))
    errors, covariances = pose_errors(scene, results)
    assert 1e-3 < np.linalg.norm(errors[-1, 3:]) < 0.3  # metres on 32 m; measured 0.03
    values, used = nees(errors[5:], covariances[5:])
    assert used.all() and 0.5 < values.mean() < 10  # measured 4.6 to 5.5


def test_visual_slam_that_starts_from_odometry_is_consistent():
    """Its first depths share the error of one motion; taken as independent, the mean over these seeds is 15."""
    values = []
    for seed in range(6):
        scene = simulate_flight(frames=50, seed=seed, noise=0.5, landmarks=4000)
        settings = ["mode=vslam", f"seed={seed}", "scale.source=oracle", "vo.ransac_threshold=1"]
        results = list(run(scene, load_config(settings=settings)))
        values.append(nees(*pose_errors(scene, results[2:]))[0].mean())
    assert 3 < np.mean(values) < 8  # measured 5.2


@pytest.mark.parametrize("online", ["continuous", "latest"])
def test_the_graph_at_every_fifth_frame(flown, online):
    flown = flown.select(0, 23)  # the last turn is at frame 21, and nothing tells more of the scale after it
    estimator = frame_estimator(flown, load_config(settings=["mode=graph", f"graph.online={online}"]))
    results = list(through(estimator, flown))
    ran = [result for result in results if result.slam is not None]
    assert np.all(np.diff([result.index for result in ran]) == 5)
    assert {result.status for result in results[1:]} == {Status.TRACKED}
    assert all(result.times["fusion"] > 0 for result in ran[1:])
    smoothed = estimator.finish().smoothed
    assert len(smoothed) == 23
    apart = smoothed.poses[ran[-1].index].between(ran[-1].pose.mean)
    assert apart.rotation().equals(gtsam.Rot3(), 1e-5)
    jump = np.linalg.norm(apart.translation())  # metres; measured 0.04 and 0.0001
    assert (1e-3 < jump < 1) if online == "continuous" else jump < 1e-3
    error = smoothed.poses[-1].between(flown.ground_truth.poses[22])
    assert 0.001 < np.linalg.norm(error.translation()) < 0.5  # metres on 29 m; measured 0.1


@pytest.mark.parametrize("source", ["map", "unit"])
def test_a_graph_without_metres(flown, source):
    """Lengths are those of odometry: with its first scale, or each 1 m."""
    results = list(estimate(flown, load_config(settings=["mode=graph", f"scale.source={source}"])))
    vo = list(estimate(flown, load_config(settings=["mode=vo", f"scale.source={source}"])))
    far, expected = (np.linalg.norm(run[-1].pose.mean.translation()) for run in (results, vo))
    assert far == pytest.approx(expected, rel=0.02)


def test_thirty_black_images(flown):
    """The run goes on, the covariance grows, and when it is light again, the motion is known again."""
    long = open_sequence("synthetic:uav?frames=60")
    dark = np.zeros((480, 640), np.uint8)
    night = replace(long, load=lambda index: dark if 15 <= index < 45 else long.load(index))
    results = list(estimate(night, load_config(settings=["mode=graph"])))
    assert [result.status for result in results[16:45]] == [Status.COASTED] * 29
    spread = [np.trace(result.pose.covariance[3:, 3:]) for result in results]
    assert spread[44] > 100 * spread[14]
    assert {result.status for result in results[52:]} == {Status.TRACKED}
    truth = long.ground_truth.poses
    for result in results[52:]:
        error = result.relative.mean.between(truth[result.previous].between(truth[result.index]))
        assert np.linalg.norm(error.translation()) < 0.3  # metres in up to 7 m


def test_what_the_graph_knows_of_the_pose_is_not_counted_twice(estimated):
    """Tracks that are landmarks are left out of odometry, which then comes out otherwise."""
    assert load_config().graph.shared_pixels == "deflate"
    runs = [
        estimated("mode=graph", *change)
        for change in (["graph.shared_pixels=exclude"], ["graph.shared_pixels=ignore"], [])
    ]
    apart = [
        [np.abs(a.pose.mean.localCoordinates(b.pose.mean)).max() for a, b in zip(runs[0], other, strict=True)]
        for other in runs[1:]
    ]
    assert all(0 < max(differences) < 0.1 for differences in apart)


def test_the_folder_of_a_graph_run(flown, tmp_path):
    config = load_config(settings=["mode=graph"])
    run = run_sequence(flown, config, tmp_path)
    assert run.smoothed is not None and len(run.smoothed) == len(run.online) == 24
    assert not np.allclose(run.smoothed.positions[1:], run.online.positions[1:], atol=1e-6)
    for name in GRAPH_FILES:
        assert (tmp_path / name).stat().st_size > 100
    assert "fusion_ms" in run.frames
    evaluation = evaluate_run(tmp_path)
    own = np.linalg.norm(run.smoothed.positions - flown.ground_truth.positions, axis=1)
    assert 0 < evaluation.smoothed < np.sqrt(np.mean(own**2))  # before alignment
    assert json.loads((tmp_path / METRICS_FILE).read_text())["ape_smoothed"] == evaluation.smoothed


def test_heights_that_are_exact_above_ground_that_is_not():
    """As of a vehicle that stands on the ground, and of synthetic worlds."""
    flown = synthetic_sequence("uav", frames=12, size="160x120")
    assert flown.ground.height_sigma == 0
    config = load_config(settings=["mode=graph", "graph.heights=true"])
    estimator = frame_estimator(flown, config)
    results = list(through(estimator, flown))
    assert len(results) == 12 and np.isfinite(results[-1].pose.covariance).all()
    assert estimator.finish().smoothed.path_length > 5


def test_visual_slam_that_has_lost_its_map_is_told_metres_once_more():
    """Upside down for a while: the map that it makes of that on its own would have a scale of its own, too."""
    street = rendered("drive", frames=40, size="480x150")
    flipped = replace(
        street, load=lambda i: np.ascontiguousarray(street.load(i)[:, ::-1] if 12 <= i < 20 else street.load(i))
    )
    results = list(estimate(flipped, load_config(settings=["mode=vslam"])))
    assert Status.REINITIALISED in {result.status for result in results[12:26]}
    truth = flipped.ground_truth.poses
    moved, true = (
        a.between(b).translation() for a, b in ((truth[32], truth[39]), (results[32].pose.mean, results[39].pose.mean))
    )
    assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm(true), rel=0.15)
    assert results[-1].slam.scale_sigma < 0.2
