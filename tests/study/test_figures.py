"""The figures of a study of ten sequences, six modes and their variants: no text is cut or covered."""

import numpy as np
import pytest

from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.study import figures, statistics
from fvslam_graph.study.results import EXTERNAL, StudyResults
from fvslam_graph.study.statistics import differences

MODES = ("vo", "vslam", "average", "intersection", "graph", "ORB-SLAM3")
CLEAR = 0.08  # of the ink of a legend's handles; measured 0.4 at least


@pytest.fixture
def results(monkeypatch) -> StudyResults:
    monkeypatch.setattr(figures, "FIGURE_SUFFIXES", (".png",))
    monkeypatch.setattr(statistics, "RESAMPLES", 99)
    rng = np.random.default_rng(0)
    rows = [
        {
            **{"sequence": sequence, "mode": mode, "preset": EXTERNAL if mode == MODES[-1] else "tuned"},
            **{"variant": variant, "seed": seed, "status": "finished", "scale_source": "plane"},
            **{"ape": ape, "ape_common": ape, "rpe": rpe, "rpe_common": rpe, "ms": rng.uniform(5, 50)},
        }
        for sequence in (*(f"2011_09_26_drive_000{n}_sync" for n in range(9)), "synthetic:uav?frames=120&seed=1")
        for mode in MODES
        for variant in (("",) if mode == MODES[-1] else ("graph.lag=5", "graph.lag=20, slam.interleave=10"))
        for seed in range(5)
        for ape, rpe in [(rng.lognormal(-3), rng.lognormal(-5))]
    ]
    return StudyResults.of(rows, Alignment.SIM3)


def test_nothing_is_cut_or_covered_and_modes_can_be_told_apart(results, drawn, tmp_path):
    files = figures.draw_study(results, differences(results), tmp_path)
    assert [file.stem for file in files] == ["accuracy", "cost", "differences"] and len(drawn) == 3
    for figure in drawn:
        assert len(figure.texts) > 50
        assert (figure.clipped(), figure.overlapping()) == ([], [])
    assert min(drawn[1].differences().values()) > CLEAR


def test_one_sequence_is_drawn_in_the_width_of_a_column(results, drawn, tmp_path):
    table = results.table[results.table["sequence"] == "synthetic:uav?frames=120&seed=1"]
    alone = StudyResults(table, results.align)
    figures.draw_study(alone, differences(alone), tmp_path)
    assert [figure.figure.get_figwidth() for figure in drawn[:2]] == [3.5, 3.5]
    for figure in drawn:
        assert (figure.clipped(), figure.overlapping()) == ([], [])
