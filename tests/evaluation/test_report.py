import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from rich.table import Table

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.evaluation.report import RUN_COLUMNS, runs_table, summary_table
from fvslam_graph.evaluation.runs import evaluate_run

from .conftest import MakeRun, drive


def row(folder: Path) -> dict[str, str]:
    return dict(zip(RUN_COLUMNS, runs_table([folder]).rows[0], strict=True))


def shown(*tables: Table) -> str:
    console = Console(width=80, record=True, file=io.StringIO())
    for table in tables:
        console.print(table)
    return console.export_text()


def test_a_row_says_what_was_measured(make_run: MakeRun) -> None:
    folder = make_run()
    evaluation = evaluate_run(folder)
    cells = row(folder)
    assert [cells[name] for name in ("run", "mode", "scale", "status", "align")] == [
        *("run", "vo", "plane", "finished", "se3"),
    ]
    assert (cells["coverage"], cells["tracked"]) == ("100.0 %", "96.0 %")
    assert float(cells["APE (m)"]) == pytest.approx(evaluation.errors["ape_trans"].stats["rmse"], abs=5e-4)
    assert float(cells["t_rel (%)"]) == pytest.approx(evaluation.drift.t_rel, abs=5e-3)
    assert evaluation.consistency is not None
    assert cells["NEES (95 % band)"].startswith(f"{evaluation.consistency.mean:.2f} (5.")
    assert 8 <= float(cells["ms/frame"]) <= 9
    assert 20 < float(cells["peak MB"]) < 10_000


def test_failed_partial_and_unevaluated_runs_are_rows(make_run: MakeRun, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="lost"):
        make_run("failed", truth=drive(60), frames=240, stop=ValueError("lost [bold] | all"))
    cells = row(tmp_path / "failed")
    assert cells["status"] == "failed: lost [bold] | all"
    assert (cells["coverage"], cells["APE (m)"], cells["NEES (95 % band)"]) == ("25.0 %", "-", "-")


def test_the_tables_hold_all_runs(make_run: MakeRun) -> None:
    folders = [make_run("good"), make_run("bad|run", seed=1, scale_source="[unit]")]
    evaluate_run(folders[0])
    lines = runs_table(folders).markdown().splitlines()
    assert [line.replace("\\|", "").count("|") for line in lines[:4]] == [len(RUN_COLUMNS) + 1] * 4
    assert lines[3].startswith("| bad\\|run | vo | [unit] | finished |")
    text = shown(*runs_table(folders).rich(80))
    words = {word for name in RUN_COLUMNS for word in name.split()}
    assert all(name in text for name in ("good", "bad|run", "[unit]", *words))
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize(
    "content", ["{", "null", '{"drift": 3}', '{"ape_scaled": "x"}', '{"nees": {"pose": {"mean": 1}}}']
)
def test_a_damaged_metrics_file_is_one_sentence(make_run: MakeRun, content: str) -> None:
    folder = make_run(truth=drive(20))
    (folder / "metrics.json").write_text(content)
    with pytest.raises(ResultsError, match=r"metrics\.json cannot be read"):
        runs_table([folder])


def test_the_summary_holds_every_metric_that_there_is(make_run: MakeRun) -> None:
    evaluation = evaluate_run(make_run(gain=0.9, frames=500))
    text = shown(summary_table(evaluation))
    assert "50.0 % of 500 frames" in text
    assert "250 of 250 poses by nearest stamps" in text
    assert f"RMSE {evaluation.errors['ape_trans'].stats['rmse']:.4g} m" in text
    assert f"{evaluation.drift.t_rel:.2f} % ({evaluation.drift_scaled.t_rel:.2f} % after scaling)" in text
    assert "239 motions" in text

    short = shown(summary_table(evaluate_run(make_run("short", truth=drive(20)))))
    assert "t_rel  " not in short
    assert "no t_rel and r_rel: the path of 19.0 m is shorter than 100 m" in short


def test_a_smoothed_trajectory_that_is_not_determined_is_said(make_run: MakeRun) -> None:
    assert row(make_run(smoothed="not determined: it is singular"))["smoothed (m)"] == "not determined"


def test_covariances_that_say_nothing_have_no_nees(make_run: MakeRun) -> None:
    folder = make_run(truth=drive(20))
    with np.load(folder / "covariances.npz") as file:
        arrays = dict(file)
    np.savez(folder / "covariances.npz", **arrays | {"covariances": np.zeros((20, 6, 6))})
    evaluation = evaluate_run(folder)
    assert evaluation.consistency is None and any("no NEES" in note for note in evaluation.notes)
