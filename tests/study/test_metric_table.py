"""The table of a paper holds the numbers of results.csv, fits a page, and says what they are."""

import re
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest
import yaml

from fvslam_graph.core.errors import StudyError
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.study.metric_table import MetricTable, TableFormat
from fvslam_graph.study.results import StudyResults

MODES = ("vo", "graph", "DSO_1")
SEQUENCES = [f"road & facades {number}" for number in range(12)]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """The results of a study of twelve sequences with three seeds; one run failed, and one mode is missing once."""
    rng = np.random.default_rng(0)
    rows = [
        {
            **{"sequence": sequence, "mode": mode, "preset": "tuned", "variant": "", "seed": seed},
            **{"status": "finished", "scale_source": "plane", "ape": gain * rng.uniform(0.05, 20)},
        }
        for sequence in SEQUENCES
        for mode, gain in zip(MODES, (1.0, 0.5, 2.0), strict=True)
        for seed in range(3)
    ]
    rows[0] |= {"status": "failed: lost", "ape": np.nan}
    rows = [row for row in rows if (row["mode"], row["sequence"]) != ("DSO_1", SEQUENCES[1])]
    folder = tmp_path_factory.mktemp("study")
    StudyResults.of(rows, Alignment.SIM3).table.to_parquet(folder / "results.parquet")
    (folder / "study.yaml").write_text(yaml.safe_dump({"align": "sim3"}))
    return folder


@pytest.fixture
def table(study):
    return MetricTable.of(study, "mode", "sequence", "ape")


def test_values_are_those_of_the_results(study, table, tmp_path):
    runs = pd.read_parquet(study / "results.parquet")
    (tmp_path / "table.csv").write_text(table.text(TableFormat.CSV))
    written = pd.read_csv(tmp_path / "table.csv", index_col="mode")
    assert list(written) == SEQUENCES and list(written.index) == list(MODES)
    for mode in MODES:
        for sequence in SEQUENCES:
            here = runs[(runs["mode"] == mode) & (runs["sequence"] == sequence)]["ape"]
            assert written.loc[mode, sequence] == pytest.approx(here.median(), rel=1e-12, nan_ok=True)
    assert np.isnan(written.loc["DSO_1", SEQUENCES[1]])


@pytest.mark.parametrize("turned", [False, True])
def test_the_best_and_the_second_are_marked(study, turned):
    table = MetricTable.of(study, *(("sequence", "mode") if turned else ("mode", "sequence")), "ape")
    ranks = table.ranks() if turned else table.ranks().T
    values = table.values if turned else table.values.T
    for sequence in SEQUENCES:
        ordered = values.loc[sequence].dropna().sort_values().index
        assert [ranks.loc[sequence, mode] for mode in ordered] == [1, 2, 3][: len(ordered)]
    assert MetricTable.of(study, "mode", "sequence", "nees").ranks().isna().all().all()
    text = table.text(TableFormat.MARKDOWN)
    assert text.count("**") == 2 * 12 and text.count("<u>") == 12 and text.count("| -- |") == 1
    assert text.endswith(
        "ape (m), online trajectories, on each one's own frames, sim3 alignment, scale from plane: median over 105 "
        "runs with 3 seeds. Bold is the best of a sequence, underlined the second. Runs that failed: 1 of "
        f"{'road & facades 0 on vo' if turned else 'vo on road & facades 0'}.\n"
    )


def test_latex_holds_the_same_numbers(table):
    text = table.text(TableFormat.LATEX)
    lines = [line for line in text.splitlines() if line.split(" & ")[0] in ("vo", "graph", r"DSO\_1")]
    for mode, line in zip(MODES, lines, strict=True):
        found = [re.findall(r"\d+\.\d+(?=$|[ }])", cell)[-1:] for cell in line.rstrip("\\ ").split(" & ")[1:]]
        expected = [
            [] if np.isnan(value) else [f"{value:.{table.decimals}f}"] for value in table.values.loc[mode].tolist()
        ]
        assert found == expected
    assert r"road \& facades 3" in text and text.count(r"\bfseries") == text.count(r"\underline") == 12


@pytest.mark.skipif(
    shutil.which("pdflatex") is None, reason="there is no LaTeX; on Debian: apt-get install texlive-science"
)
@pytest.mark.parametrize("rows", ["mode", "sequence"])
def test_latex_takes_it_and_it_fits_the_page(study, tmp_path, rows):
    columns = "sequence" if rows == "mode" else "mode"
    (tmp_path / "table.tex").write_text(MetricTable.of(study, rows, columns, "ape").text(TableFormat.LATEX))
    packages = r"\usepackage{booktabs,graphicx,siunitx}"
    document = rf"\documentclass{{article}}{packages}\begin{{document}}\input{{table}}\ref{{tab:ape}}\end{{document}}"
    (tmp_path / "page.tex").write_text(document)
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "page.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:]
    assert "Overfull" not in done.stdout and "Package siunitx Error" not in done.stdout


def test_on_the_command_line(fvslam, study, tmp_path):
    assert fvslam("table", study, "--metric", "ape", "--format", "csv").out.splitlines()[0].startswith("mode,road")
    ended = fvslam("table", study, "--metric", "ape", "--format", "pdf")
    assert ended.code == 1 and "--format is one of latex, md, csv, not 'pdf'" in ended.err
    ended = fvslam("table", tmp_path)
    assert ended.code == 1 and "has no results of a study; give the folder of one" in ended.err


@pytest.mark.parametrize(
    ("labels", "complaint"),
    [
        (("mod", "sequence", "ape"), "there is no row 'mod', only sequence, mode"),
        (("mode", "mode", "ape"), "rows and columns are both 'mode'"),
        (("mode", "sequence", "status"), "there is no metric 'status', only frames, coverage"),
    ],
)
def test_what_there_is_not(study, labels, complaint):
    with pytest.raises(StudyError, match=re.escape(complaint)):
        MetricTable.of(study, *labels)
