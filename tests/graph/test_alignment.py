"""The first alignment of a path with fixes."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.graph.alignment import align

UP = np.array([0.0, -1.0, 0.0])  # of a camera that looks to the horizon
ENU_T_WORLD = gtsam.Pose3(
    gtsam.Rot3.Rz(2.1) * gtsam.Rot3(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])), np.array([30.0, -20.0, 5.0])
)


def path(length: float, bend: float = 0.2, count: int = 20) -> np.ndarray:
    ahead = np.linspace(0, length, count)
    return np.column_stack([bend * length * np.sin(ahead / length), np.zeros(count), ahead])


def fixes(world: np.ndarray, sigma: float, wrong: float = 0.0, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    enu = ENU_T_WORLD.transformFrom(world.T).T + sigma * rng.standard_normal(world.shape)
    off = rng.permutation(len(world))[: round(wrong * len(world))]
    enu[off] += rng.uniform(20, 60, (len(off), 3))
    return enu


def error(found: gtsam.Pose3) -> np.ndarray:
    return gtsam.Pose3.Logmap(found.between(ENU_T_WORLD))


def test_exact_positions_give_the_exact_alignment():
    world = path(100)
    found = align(world, fixes(world, 0.0), np.full(20, 0.1), UP, 0.1)
    assert np.abs(error(found)).max() < 1e-6


@pytest.mark.parametrize("seed", range(5))
def test_a_third_of_wrong_fixes_does_no_harm(seed):
    world = path(200)
    found = align(world, fixes(world, 1.5, wrong=0.3, seed=seed), np.full(20, 1.5), UP, 0.1)
    heading = ENU_T_WORLD.rotation().between(found.rotation())
    # Measured: 0.008 to 0.035 rad, of which roll is most.
    assert np.linalg.norm(gtsam.Rot3.Logmap(heading)) < 0.15
    middle = found.transformFrom(world[10]) - ENU_T_WORLD.transformFrom(world[10])
    assert np.linalg.norm(middle) < 2.5  # half a metre is what is expected of 14 fixes


def test_the_direction_up_tells_how_a_straight_path_is_turned_about_itself():
    world = path(100, bend=0.0)
    found = align(world, fixes(world, 0.0), np.full(20, 1.0), UP, 0.1)
    assert np.abs(error(found)).max() < 1e-6


def test_a_path_that_is_short_against_the_noise_is_left_to_wait():
    world = path(2.0)
    assert align(world, fixes(world, 1.5), np.full(20, 1.5), UP, 0.1) is None


def test_too_few_fixes_that_agree_are_left_to_wait():
    world = path(100, count=3)
    assert align(world, fixes(world, 0.1), np.full(3, 0.1), UP, 0.1) is None
    world = path(100, count=6)
    assert align(world, fixes(world, 0.1, wrong=0.5), np.full(6, 0.1), UP, 0.1) is None
