"""The contract of the synthetic sequences: options, determinism, truth."""

from functools import cache

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.simulation.synthetic import open_synthetic, synthetic_sequence

SMALL = {"uav": (160, 120), "drive": (310, 94)}
WORLDS = pytest.mark.parametrize("world", ["uav", "drive"])


@cache
def empty(world: str) -> Sequence:
    return small(world)


@cache
def busy(world: str) -> Sequence:
    return small(world, movers=3)


def small(world: str, **options: object) -> Sequence:
    return synthetic_sequence(world, **{"size": SMALL[world], "frames": 12, **options})


def test_options_in_the_name_reach_the_sequence() -> None:
    name = "synthetic:uav?seed=3&frames=7&size=320x240&camera=oblique&noise=0.5"
    sequence = open_synthetic(name)
    assert (sequence.name, sequence.format, len(sequence)) == (name, "synthetic", 7)
    assert (sequence.camera.width, sequence.camera.height) == (320, 240)
    np.testing.assert_allclose(np.diff(sequence.stamps), 0.1)
    assert sequence.ground is not None
    np.testing.assert_allclose(sequence.ground.normal, [0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-12)


def test_defaults_are_those_of_the_documentation() -> None:
    uav, drive = open_synthetic("synthetic:uav"), open_synthetic("synthetic:drive")
    assert len(uav) == len(drive) == 200
    assert (uav.camera.width, uav.camera.height) == (640, 480)
    camera = drive.camera
    assert (camera.width, camera.height) == (1242, 375)
    np.testing.assert_allclose([camera.fx, camera.cx, camera.cy], [721.5, 609.6, 172.9], atol=0.05)
    assert uav.notes == drive.notes == ()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("synthetic:boat", ["'boat'", "uav", "drive"]),
        ("synthetic:uav?sed=3", ["'sed'", "nearest is 'seed'", "frames", "size", "noise", "movers", "camera"]),
        ("synthetic:drive?camera=oblique", ["'camera'", "all are seed"]),
        ("synthetic:uav?name=x", ["'name'"]),
        ("synthetic:uav?seed=1.5", ["seed", "'1.5'", "integer"]),
        ("synthetic:uav?frames=0", ["frames", "'0'", "greater"]),
        ("synthetic:uav?noise=nan", ["noise", "finite"]),
        ("synthetic:uav?noise=-1", ["noise", "'-1'"]),
        ("synthetic:uav?drop=1", ["drop", "less than 1"]),
        ("synthetic:uav?camera=up", ["camera", "'up'", "'downward' or 'oblique'"]),
        ("synthetic:uav?size=640", ["size", "'640'", "WIDTHxHEIGHT"]),
        ("synthetic:uav?size=640x9", ["size", "'9'", "32"]),
        ("synthetic:uav?seed", ["name=value"]),
        ("synthetic:uav?seed=1&seed=2", ["twice"]),
    ],
)
def test_a_bad_name_is_explained_in_one_sentence(name: str, words: list[str]) -> None:
    with pytest.raises(SequenceError) as caught:
        open_synthetic(name)
    message = str(caught.value)
    assert message.startswith(name)
    assert "\n" not in message
    assert [word for word in words if word not in message] == []


@WORLDS
def test_an_image_is_the_same_bits_in_any_order(world: str) -> None:
    backwards = {index: busy(world).load(index) for index in (7, 3)}
    again = small(world, movers=3)
    for index in (3, 7):
        np.testing.assert_array_equal(backwards[index], again.load(index))
    assert np.any(backwards[3] != backwards[7])


@WORLDS
def test_another_seed_is_another_world(world: str) -> None:
    a, b = empty(world), small(world, seed=1)
    difference = np.abs(a.load(0).astype(float) - b.load(0))
    assert np.median(difference) > 5
    assert not a.ground_truth.poses[-1].equals(b.ground_truth.poses[-1], 0.01)


@WORLDS
def test_movers_change_a_part_of_the_image(world: str) -> None:
    """The noise is the same with and without, so that all that differs is what moves."""
    for index in (0, 9):
        changed = np.mean(empty(world).load(index) != busy(world).load(index))
        assert 0.003 < changed < 0.4


def test_dropped_frames_have_no_image() -> None:
    sequence = small("drive", frames=10, drop=0.2)
    lost = [index for index in range(10) if sequence.load(index) is None]
    assert len(lost) == 2
    assert lost[0] > 0
    assert "2 of 10" in sequence.notes[0]
    assert len(sequence.ground_truth) == 10


@pytest.mark.parametrize(("world", "shortest"), [("uav", 250), ("drive", 150)])
@pytest.mark.parametrize("seed", range(5))
def test_paths_begin_at_the_origin_and_are_long_enough_for_drift(world: str, shortest: float, seed: int) -> None:
    truth = synthetic_sequence(world, seed=seed).ground_truth
    assert truth.poses[0].equals(gtsam.Pose3(), 1e-12)
    assert shortest < truth.path_length < 1.4 * shortest
    headings = truth.matrices[:, :3, 0]
    turn = np.degrees(np.arccos(np.clip(headings @ headings[0], -1, 1))).max()
    assert turn > 10


def test_the_car_camera_is_exactly_1_65_m_above_the_road() -> None:
    ground = synthetic_sequence("drive").ground
    np.testing.assert_array_equal(ground.heights, 1.65)
    np.testing.assert_array_equal(ground.normal, [0, 1, 0])
    assert 0.007 < ground.normal_sigma < 0.013


@pytest.mark.parametrize("camera", ["downward", "oblique"])
@pytest.mark.parametrize("seed", range(5))
def test_uav_heights_are_those_of_a_climbing_vehicle(camera: str, seed: int) -> None:
    sequence = synthetic_sequence("uav", camera=camera, seed=seed)
    heights = sequence.ground.heights
    assert 20 < heights.min() < heights.max() < 32
    assert np.ptp(heights) > 2
    assert 0.05 < sequence.ground.normal_sigma < 0.2
    # Heights and positions tell the same vertical: one direction explains all differences of height.
    moves = sequence.ground_truth.positions
    vertical, residual, *_ = np.linalg.lstsq(moves, heights - heights[0], rcond=None)
    assert np.linalg.norm(vertical) == pytest.approx(1, abs=1e-6)
    assert residual < 1e-12
