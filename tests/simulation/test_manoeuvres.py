"""Flights leg by leg: each does what its name says, smoothly, and odometry follows it."""

from itertools import pairwise
from typing import get_args

import gtsam
import numpy as np
import pytest

import fvslam_graph
from fvslam_graph.simulation.synthetic import open_synthetic
from fvslam_graph.simulation.worlds.manoeuvres import Manoeuvre, manoeuvre_motion
from fvslam_graph.simulation.worlds.motion import Motion

DURATION = 40.0
STAMPS = np.arange(0, DURATION, 0.1)


def flown(manoeuvre: Manoeuvre, seed: int = 0) -> Motion:
    return manoeuvre_motion(manoeuvre, seed, DURATION, altitude=27.0, depression=np.pi / 2)


def headings(motion: Motion) -> np.ndarray:
    """Where the top of the image of a camera that looks down points, radians, unwrapped."""
    tops = -motion.trajectory(STAMPS).matrices[:, :2, 1]
    return np.unwrap(np.arctan2(tops[:, 1], tops[:, 0]))


@pytest.mark.parametrize("manoeuvre", get_args(Manoeuvre))
def test_it_begins_at_its_altitude_and_stays_above_the_trees(manoeuvre):
    heights = flown(manoeuvre).trajectory(STAMPS).positions[:, 2]
    assert heights[0] == pytest.approx(27.0, abs=1e-9)
    assert heights.min() > 20


@pytest.mark.parametrize("manoeuvre", get_args(Manoeuvre))
def test_no_multirotor_brakes_harder(manoeuvre):
    motion = flown(manoeuvre)
    assert max(np.linalg.norm(motion.path(t, 2)) for t in STAMPS) < 12  # m/s^2
    poses = motion.trajectory(STAMPS).poses
    turns = [np.linalg.norm(gtsam.Rot3.Logmap(a.rotation().between(b.rotation()))) for a, b in pairwise(poses)]
    assert max(turns) < 0.25  # rad in a tenth of a second


def test_each_does_what_its_name_says():
    hover = flown("hover").trajectory(STAMPS[:40]).positions
    assert np.ptp(hover, axis=0).max() < 1.5
    turn = headings(flown("turn"))
    assert turn[140] - turn[60] == pytest.approx(8 * np.pi / 5, abs=0.3)
    climb = flown("climb").trajectory(STAMPS).positions[:, 2]
    assert climb[80] - climb[0] == pytest.approx(24, abs=3)
    sideways = flown("sideways")
    assert np.ptp(headings(sideways)) < 0.6  # it leans
    assert np.linalg.norm(sideways.path(5.0)[:2] - sideways.path(1.0)[:2]) > 20


def test_gusts_have_a_seed():
    assert np.array_equal(flown("hover", 1).path(5.0), flown("hover", 1).path(5.0))
    assert not np.array_equal(flown("hover", 1).path(5.0), flown("hover", 2).path(5.0))


def test_turning_in_place_is_followed():
    """Patches that are only shifted are lost as the image turns, and the map with them: 0.4 to 0.8 m."""
    flight = open_synthetic("synthetic:uav?manoeuvre=turn&frames=130&size=320x240")
    evaluation = fvslam_graph.evaluate(fvslam_graph.run(flight, "vo"), align="sim3")
    assert evaluation.errors["ape_trans"].stats["rmse"] < 0.15  # measured 0.07
