"""A simulated receiver, and which frames its fixes come to."""

from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.geodesy import LocalFrame
from fvslam_graph.core.sensors import SensorKind, SensorSeries
from fvslam_graph.simulation.gnss import OUTLIER, PLACE, SimulatedReceiver, true_enu
from fvslam_graph.simulation.synthetic import synthetic_sequence


@pytest.fixture
def sequence():
    return synthetic_sequence("drive", frames=400)


def errors(sequence, receiver, seed=0):
    fixes = SimulatedReceiver.parse(receiver).fixes(sequence, seed)
    truth = sequence.ground_truth.interpolate(fixes.stamps)
    return fixes, np.linalg.norm(LocalFrame(PLACE).enu(fixes.values) - true_enu(truth), axis=1)


def test_noise_outliers_and_gap_are_those_asked_for(sequence):
    fixes, off = errors(sequence, "5:0.5:0.2:4")
    middle = sequence.stamps.mean()
    assert np.abs(fixes.stamps - middle).min() >= 2 - 1e-9
    assert 0.15 < np.mean(off > OUTLIER / 2) < 0.25
    assert np.sqrt((off[off < OUTLIER / 2] ** 2).mean() / 3) == pytest.approx(0.5, rel=0.25)
    assert fixes.source == "simulated GNSS from ground truth"


def test_the_same_seed_gives_the_same_fixes(sequence):
    (a, _), (b, _), (c, _) = (errors(sequence, "5:0.5", seed) for seed in (3, 3, 4))
    assert np.array_equal(a.values, b.values) and not np.array_equal(a.values, c.values)


def test_fixes_of_a_recording_are_made_worse(sequence):
    places = np.column_stack([np.full(50, 49.0), np.full(50, 8.0), np.full(50, 100.0)])
    known = SensorSeries(SensorKind.GNSS, np.arange(50) * 0.1, places, np.full((50, 3), np.nan), "OXTS")
    fixes = SimulatedReceiver.parse("10:0.5").fixes(replace(sequence, sensors=(known,)))
    assert fixes.source == "simulated GNSS from OXTS"
    assert np.abs(LocalFrame(places[0]).enu(fixes.values)).max() < 2.5


@pytest.mark.parametrize("text", ["", "5", "0:1", "5:0", "5:1:1", "5:1:0.1:2:3", "a:b", "1e9:1", "5:1:0:nan"])
def test_what_is_no_receiver_is_one_sentence(text):
    with pytest.raises(SequenceError, match="RATE_HZ:SIGMA_M"):
        SimulatedReceiver.parse(text)


def test_a_recording_without_positions_has_nothing_to_simulate_from(sequence):
    with pytest.raises(SequenceError, match="no positions"):
        SimulatedReceiver.parse("1:1").fixes(replace(sequence, ground_truth=None))


def test_each_fix_comes_to_the_frame_after_it(sequence):
    stamps = np.array([-1.0, 0.0, 0.04, 0.09, 0.1, 0.33])
    fixes = SensorSeries(SensorKind.GNSS, stamps, np.zeros((6, 3)), np.tile([1.0, 2.0, 3.0], (6, 1)), "test")
    given = sequence.with_gnss(fixes)
    step = sequence.stamps[1]
    after = np.ceil(stamps[1:] / step - 1e-9).astype(int)
    for index in range(10):
        assert [fix.stamp for fix in given.frame(index).fixes] == stamps[1:][after == index].tolist()
    assert given.frame(0).fixes[0].sigmas.tolist() == [2.0, 1.0, 3.0]  # of the series: north, east, up
    thinned = given.select(stride=4)
    assert sum(len(frame.fixes) for frame in (thinned.frame(i) for i in range(5))) == 5
    assert sequence.frame(1).fixes == ()


def test_fixes_without_a_deviation_are_refused(sequence):
    fixes = SensorSeries(SensorKind.GNSS, np.zeros(1), np.zeros((1, 3)), np.full((1, 3), np.nan), "test")
    with pytest.raises(SequenceError, match="--gnss-sigma"):
        sequence.with_gnss(fixes)
    with pytest.raises(SequenceError, match="--gnss-sigma"):
        sequence.with_gnss(fixes, 0.0)
    with pytest.raises(SequenceError, match="--gnss-sigma"):
        sequence.with_gnss(fixes, np.inf)
    assert sequence.with_gnss(fixes, 2.0).gnss.sigmas.tolist() == [[2.0] * 3]
