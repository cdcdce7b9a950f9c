"""From a declaration to tables, figures and a report that opens in a browser."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from evo.core.metrics import PoseRelation
from evo.main_ape import ape

from fvslam_graph.core.files import file_name
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.study.results import spread

from .conftest import SHORT


def test_the_table_is_tidy(small_study):
    table = pd.read_parquet(small_study / "results.parquet")
    pd.testing.assert_frame_equal(
        table,
        pd.read_csv(small_study / "results.csv", dtype=dict(table.dtypes), keep_default_na=True).fillna(
            {"scale_source": "", "variant": "", "unjudged": "", "note": "", "folder": ""}
        ),
    )
    assert len(table) == 3 * 2 * 2 + 3
    finished = table[table["status"] == "finished"]
    assert len(finished) == 10
    perfect = finished[finished["mode"] == "perfect"].iloc[0]
    assert perfect["ape"] < 1e-6 and (perfect["coverage"], perfect["associated"]) == (1, 12)
    for row in finished.itertuples():
        if row.folder:
            metrics = json.loads((small_study / "runs" / row.folder / "metrics.json").read_text())
            assert metrics["ape_trans"]["rmse"] == row.ape and metrics["alignment"] == "sim3"
    assert pd.read_csv(small_study / "costs.csv")["ms"].notna().sum() == 8


def test_all_are_compared_on_the_frames_that_all_have(small_study, drive, tmp_path):
    """One system has poses for nine frames alone; evo finds the same errors of the others on these nine."""
    table = pd.read_parquet(small_study / "results.parquet")
    here = table[(table["sequence"] == "road & facades") & (table["status"] == "finished")]
    assert len(here) == 2 * 2 + 2 and set(here["common"]) == {9}
    assert here["associated"].tolist() == [12, 12, 12, 12, 12, 9] and here["coverage"].max() == 1
    late = here[here["mode"] == "late"].iloc[0]
    assert (late["ape"], late["rpe"], late["coverage"]) == (late["ape_common"], late["rpe_common"], 0.75)
    for row in here[here["folder"] != ""].itertuples():
        assert row.ape_common != row.ape and row.rpe_common != row.rpe
        for name in ("trajectory_online", "reference"):
            whole = Trajectory.read(small_study / "runs" / row.folder / f"{name}.tum")
            Trajectory(whole.stamps[3:], whole.poses[3:]).write_tum(tmp_path / f"{name}.tum")
        theirs = ape(
            *(Trajectory.read(tmp_path / f"{name}.tum").to_evo() for name in ("reference", "trajectory_online")),
            PoseRelation.translation_part,
            align=True,
            correct_scale=True,
        )
        assert theirs.stats["rmse"] == pytest.approx(row.ape_common, rel=1e-9)
    elsewhere = table[(table["sequence"] == SHORT) & (table["status"] == "finished")]
    assert (elsewhere["ape_common"] == elsewhere["ape"]).all() and set(elsewhere["common"]) == {12}
    assert "| 9 | " in (small_study / "summary.md").read_text()


@pytest.mark.parametrize("program", ["evo_ape", "evo_rpe"])
def test_evo_prints_the_same_digits(small_study, tmp_path, program):
    table = pd.read_parquet(small_study / "results.parquet")
    row = table[(table["mode"] == "average") & (table["folder"] != "")].iloc[0]  # one is enough: evo takes a second
    options = ["--delta", "1", "--delta_unit", "f"] if program == "evo_rpe" else []
    command = [Path(sys.executable).parent / program, "tum", "reference.tum", "trajectory_online.tum", "-as", *options]
    environment = os.environ | {"HOME": str(tmp_path)}
    printed = subprocess.run(
        command, cwd=small_study / "runs" / row["folder"], env=environment, capture_output=True, text=True, check=True
    ).stdout
    assert re.search(r"rmse\s+([\d.]+)", printed)[1] == f"{row['ape' if program == 'evo_ape' else 'rpe']:.6f}"


def test_every_run_is_in_the_summary(small_study):
    markdown = (small_study / "summary.md").read_text()
    rows = [line.split(" | ") for line in markdown.splitlines() if line.startswith("|")]
    assert len(rows) == 2 + 3 * 2 + 3 and len({len(row) for row in rows}) == 1
    assert markdown.count("| 2/2 |") == 4 and markdown.count("| 0/2 |") == 2
    assert "sim3 alignment, scale from plane" in markdown
    latex = (small_study / "summary.tex").read_text()
    assert latex.count(r"\\") == 1 + 3 * 2 + 3 and r"road \& facades" in latex and r"lost\_100\%" in latex
    assert all(rule in latex for rule in (r"\toprule", r"\midrule", r"\bottomrule"))


def test_latex_takes_it(small_study, tmp_path):
    if shutil.which("pdflatex") is None:
        pytest.skip("there is no LaTeX here")
    document = r"\documentclass{article}\usepackage{booktabs}\begin{document}\input{summary}\end{document}"
    (tmp_path / "page.tex").write_text(document)
    shutil.copy(small_study / "summary.tex", tmp_path)
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "page.tex"]
    assert subprocess.run(command, cwd=tmp_path, capture_output=True).returncode == 0


def test_the_figures(small_study):
    names = {path.name for path in (small_study / "figures").glob("*.png")}
    assert names == {"accuracy.png", "cost.png", "differences.png"}
    for sequence in map(file_name, (SHORT, "road & facades")):
        for name in ("plot_trajectory", "plot_error", "plot_drift", "plot_covariance", "plot_nees"):
            for suffix in (".png", ".pdf", ".svg"):
                assert (small_study / "figures" / sequence / f"{name}{suffix}").stat().st_size > 5000


@pytest.mark.parametrize(
    ("values", "style", "shown"),
    [
        ([0.398, 0.392, 0.399], ".3f", "0.398 (0.392-0.399)"),
        ([0.00304], ".3f", "0.0030"),
        ([1e-15], ".3f", "0.000"),
        ([9, 9], ".0f", "9"),
        ([np.nan], ".3f", "-"),
    ],
)
def test_small_values_keep_two_digits(values, style, shown):
    assert spread(values, style) == shown
