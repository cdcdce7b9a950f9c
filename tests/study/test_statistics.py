"""Differences are called significant where they are, and not more often than they should."""

import numpy as np
import pandas as pd
import pytest

from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.study.results import EXTERNAL, StudyResults
from fvslam_graph.study.statistics import ALL, CONFIDENCE, differences, differences_table, interval, verdicts


def outcome(errors, sequences=("a",)):
    """Runs whose errors are given by mode, one a seed, and times a factor for each sequence."""
    rows = [
        {
            **{"sequence": name, "mode": mode, "preset": "tuned", "variant": "", "seed": seed, "status": "finished"},
            **{"ape_common": (3 if name == "a" else 1) * error, "rpe_common": 1.0},
        }
        for name in sequences
        for mode, values in errors.items()
        for seed, error in enumerate(values)
    ]
    return StudyResults.of(rows, Alignment.SIM3)


def by_modes(found, metric="ape", sequence="a"):
    return {(d.a, d.b): d for d in found if (d.metric, d.sequence) == (metric, sequence)}


@pytest.mark.parametrize(("count", "low", "high"), [(5, 0.75, 0.90), (20, 0.87, 0.96)])
def test_how_often_an_interval_holds(count, low, high):
    """The caption says five in six for five values; normal values with mean 0, 400 times: measured 0.84 and 0.91."""
    rng = np.random.default_rng(0)
    held = [a <= 0 <= b for a, b in (interval(rng.standard_normal(count), seed) for seed in range(400))]
    assert low < np.mean(held) < high < CONFIDENCE + 0.02


def test_pairs_take_out_what_the_seeds_have_in_common():
    rng = np.random.default_rng(1)
    luck = rng.uniform(0.5, 2, 12)  # of the seed, much larger than the difference
    found = by_modes(differences(outcome({"vo": luck, "graph": 0.9 * luck, "average": rng.permutation(luck)})))
    assert found["vo", "graph"].ratio == pytest.approx(1 / 0.9)
    assert found["vo", "graph"].range == pytest.approx(2 * (1 / 0.9,))
    assert found["vo", "average"].range[0] < 0.8 < 1.2 < found["vo", "average"].range[1]


def test_seeds_make_nothing_significant():
    """However many, on one recording or on a few: they say nothing of other recordings."""
    for names in (("a",), ("a", "b", "c")):
        found = differences(outcome({"vo": np.ones(50), "graph": 0.5 * np.ones(50)}, names))
        assert not any(difference.significant for difference in found)
        assert {difference.recordings for difference in found} == {1, len(names)}
        assert (
            f"n = {len(names)}): too few recordings to tell a difference from chance; 5 are needed"
            in verdicts(found)[0]
        )
    names = [f"s{i}" for i in range(6)]
    found = differences(outcome({"vo": np.ones(1), "graph": 0.5 * np.ones(1)}, names))
    (whole,) = [one for one in found if (one.metric, one.sequence) == ("ape", ALL)]
    assert whole.significant and whole.recordings == 6
    assert verdicts(found)[0] == f"APE on {ALL} (n = 6): graph is better than vo (50 %); all are significant."


def test_all_sequences_count_alike():
    rng = np.random.default_rng(2)
    names = [f"s{i}" for i in range(8)]
    rows = []
    for name in names:
        table = outcome({"vo": np.ones(5), "graph": np.exp(rng.normal(0, 0.3)) * np.ones(5)}, [name]).table
        rows += table.to_dict("records")
    found = by_modes(differences(StudyResults.of(rows, Alignment.SIM3)), sequence=ALL)["vo", "graph"]
    assert found.recordings == 8 and not found.significant  # though on each sequence the difference is certain
    assert found.low < found.ratio < found.high


def test_failed_runs_are_counted():
    table = outcome({"vo": np.ones(6), "graph": 0.5 * np.ones(6)}).table
    table.loc[0, ["status", "ape_common"]] = ["failed: lost", np.nan]
    found = by_modes(differences(StudyResults(table, Alignment.SIM3)))["vo", "graph"]
    assert (found.failed, found.ratio, found.recordings) == (1, 2, 1)
    assert differences_table([found]).rows[0][-2] == "1"


def test_other_systems_have_no_seed_and_are_compared():
    names = [f"s{i}" for i in range(5)]
    table = outcome({"vo": [1.0, 4.0], "graph": [1.0, 1.0], "DSO": [1.0]}, names).table
    table.loc[table["mode"] == "DSO", ["preset", "seed"]] = [EXTERNAL, pd.NA]
    found = by_modes(differences(StudyResults(table, Alignment.SIM3)), sequence=ALL)
    assert found["vo", "DSO"].ratio == pytest.approx(2) and found["vo", "DSO"].recordings == 5
    assert found["graph", "DSO"].ratio == pytest.approx(1) and not found["graph", "DSO"].significant


def test_runs_with_other_settings_are_not_mixed():
    rows = []
    for preset, gain in (("tuned", 0.5), ("paper", 2.0)):
        table = outcome({"vo": np.ones(5), "graph": gain * np.ones(5)}).table
        rows += table.assign(preset=preset).to_dict("records")
    found = differences(StudyResults.of(rows, Alignment.SIM3))
    assert {(d.sequence, round(d.ratio, 6)) for d in found if d.metric == "ape"} == {("a, tuned", 2), ("a, paper", 0.5)}


def test_a_mode_is_compared_with_all_settings_that_it_does_not_read():
    rows = []
    for mode, variant, error in (
        ("vo", "", 1.0),
        ("average", "fusion.weight=0.3, slam.shorten=true", 2.0),
        ("average", "fusion.weight=0.5, slam.shorten=true", 3.0),
        ("graph", "slam.shorten=true, graph.lag=5", 4.0),
        ("graph", "slam.shorten=false, graph.lag=5", 5.0),
    ):
        rows += outcome({mode: [error]}, ("b",)).table.assign(variant=variant).to_dict("records")
    found = differences(StudyResults.of(rows, Alignment.SIM3))
    ratios = {(d.a, d.b, d.sequence.removeprefix("b, ")): d.ratio for d in found if d.metric == "ape"}
    assert len(ratios) == 2 + 2 + 2
    assert ratios["vo", "average", "fusion.weight=0.5, slam.shorten=true"] == pytest.approx(1 / 3)
    assert ratios["average", "graph", "fusion.weight=0.3, slam.shorten=true, graph.lag=5"] == pytest.approx(1 / 2)


def test_it_is_said_in_words_and_in_a_table():
    rng = np.random.default_rng(3)
    names = [f"s{i}" for i in range(10)]
    rows = []
    for name in names:
        noise = np.exp(0.05 * rng.standard_normal(3))
        errors = {"vo": noise[:1], "average": 1.001 * noise[1:2], "graph": 0.5 * noise[2:]}
        rows += outcome(errors, [name]).table.to_dict("records")
    found = differences(StudyResults.of(rows, Alignment.SIM3))
    sentence = verdicts(found)[0]
    assert sentence.startswith(f"APE on {ALL} (n = 10): graph is better than vo (5")
    assert sentence.endswith("; not significant: vo and average.")
    table = differences_table([one for one in found if one.sequence == ALL], "Online.")
    assert [row[2] for row in table.rows[:3]] == ["vo / average", "vo / graph", "average / graph"]
    assert [row[-1] for row in table.rows[:3]] == ["no", "yes", "yes"] and {row[-3] for row in table.rows} == {"10"}
    assert table.caption.startswith("Online. Ratio of the errors")
