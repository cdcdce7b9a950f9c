"""From a declaration to tables, figures and a report that opens in a browser."""

import html
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import gtsam
import numpy as np
import pandas as pd
import pytest
from evo.core.metrics import PoseRelation
from evo.main_ape import ape

from fvslam_graph.core.files import file_name
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.study.run import run_study
from fvslam_graph.study.spec import Study

from .conftest import SHORT

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def folder(drive, tmp_path_factory):
    """Of a study with a recording, a world, other people's trajectories and a recording that is not there."""
    out = tmp_path_factory.mktemp("study")
    late = tmp_path_factory.mktemp("others") / "late.tum"
    truth = open_sequence(drive).ground_truth
    rng = np.random.default_rng(0)
    noisy = tuple(pose * gtsam.Pose3(gtsam.Rot3(), 0.02 * rng.standard_normal(3)) for pose in truth.poses[3:])
    Trajectory(truth.stamps[3:] - 0.004, noisy).write_tum(late)
    study = Study(
        name="A <small> study",
        sequences=[SHORT, {"path": str(drive), "name": "road & facades"}, str(out / "absent")],
        modes=["vo", "average"],
        seeds=2,
        external={
            "road & facades": {
                "perfect": str(drive / "groundtruth.tum"),
                "lost_100%": str(drive / "camera.yaml"),
                "late": str(late),
            }
        },
    )
    run_study(study, out, workers=1)
    return out


def test_the_table_is_tidy(folder):
    table = pd.read_parquet(folder / "results.parquet")
    pd.testing.assert_frame_equal(
        table,
        pd.read_csv(folder / "results.csv", dtype=dict(table.dtypes), keep_default_na=True).fillna(
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
            metrics = json.loads((folder / "runs" / row.folder / "metrics.json").read_text())
            assert metrics["ape_trans"]["rmse"] == row.ape and metrics["alignment"] == "sim3"
    assert pd.read_csv(folder / "costs.csv")["ms"].notna().sum() == 8


def test_all_are_compared_on_the_frames_that_all_have(folder, drive, tmp_path):
    """One system has poses for nine frames alone; evo finds the same errors of the others on these nine."""
    table = pd.read_parquet(folder / "results.parquet")
    here = table[(table["sequence"] == "road & facades") & (table["status"] == "finished")]
    assert len(here) == 2 * 2 + 2 and set(here["common"]) == {9}
    assert here["associated"].tolist() == [12, 12, 12, 12, 12, 9] and here["coverage"].max() == 1
    late = here[here["mode"] == "late"].iloc[0]
    assert (late["ape"], late["rpe"], late["coverage"]) == (late["ape_common"], late["rpe_common"], 0.75)
    for row in here[here["folder"] != ""].itertuples():
        assert row.ape_common != row.ape and row.rpe_common != row.rpe
        for name in ("trajectory_online", "reference"):
            whole = Trajectory.read(folder / "runs" / row.folder / f"{name}.tum")
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
    assert "| 9 | " in (folder / "summary.md").read_text()


@pytest.mark.parametrize("program", ["evo_ape", "evo_rpe"])
def test_evo_prints_the_same_digits(folder, tmp_path, program):
    table = pd.read_parquet(folder / "results.parquet")
    row = table[(table["mode"] == "average") & (table["folder"] != "")].iloc[0]  # one is enough: evo takes a second
    options = ["--delta", "1", "--delta_unit", "f"] if program == "evo_rpe" else []
    command = [Path(sys.executable).parent / program, "tum", "reference.tum", "trajectory_online.tum", "-as", *options]
    environment = os.environ | {"HOME": str(tmp_path)}
    printed = subprocess.run(
        command, cwd=folder / "runs" / row["folder"], env=environment, capture_output=True, text=True, check=True
    ).stdout
    assert re.search(r"rmse\s+([\d.]+)", printed)[1] == f"{row['ape' if program == 'evo_ape' else 'rpe']:.6f}"


def test_every_run_is_in_the_summary(folder):
    markdown = (folder / "summary.md").read_text()
    rows = [line.split(" | ") for line in markdown.splitlines() if line.startswith("|")]
    assert len(rows) == 2 + 3 * 2 + 3 and len({len(row) for row in rows}) == 1
    assert markdown.count("| 2/2 |") == 4 and markdown.count("| 0/2 |") == 2
    assert "sim3 alignment, scale from plane" in markdown
    latex = (folder / "summary.tex").read_text()
    assert latex.count(r"\\") == 1 + 3 * 2 + 3 and r"road \& facades" in latex and r"lost\_100\%" in latex
    assert all(rule in latex for rule in (r"\toprule", r"\midrule", r"\bottomrule"))


def test_latex_takes_it(folder, tmp_path):
    if shutil.which("pdflatex") is None:
        pytest.skip("there is no LaTeX here")
    document = r"\documentclass{article}\usepackage{booktabs}\begin{document}\input{summary}\end{document}"
    (tmp_path / "page.tex").write_text(document)
    shutil.copy(folder / "summary.tex", tmp_path)
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "page.tex"]
    assert subprocess.run(command, cwd=tmp_path, capture_output=True).returncode == 0


def test_the_figures(folder):
    names = {path.name for path in (folder / "figures").glob("*.png")}
    assert names == {"accuracy.png", "cost.png", "differences.png"}
    for sequence in map(file_name, (SHORT, "road & facades")):
        for name in ("plot_trajectory", "plot_error"):
            for suffix in (".png", ".pdf", ".svg"):
                assert (folder / "figures" / sequence / f"{name}{suffix}").stat().st_size > 5000


def test_the_report_needs_nothing_else(folder):
    text = (folder / "report.html").read_text()
    assert "A &lt;small&gt; study" in text and "<small>" not in text
    links = re.findall(r"""(?:src|href)=["']?([^"'> ]+)""", text)
    assert len(links) == 3 + 2 * 2 and all(link.startswith("data:") for link in links)
    for word in ("lost_100%", "does not exist", "gtsam:", "platform:", "road &amp; facades", "too few recordings"):
        assert word in text


PROBE = """
<iframe id="page" style="border:0" width="{width}" height="900" srcdoc="{page}"></iframe>
<script>
  document.getElementById("page").onload = event => {{
    const page = event.target.contentDocument, all = [...page.querySelectorAll("table")].at(-1);
    const column = [...all.tHead.rows[0].cells].findIndex(cell => cell.textContent === "ape");
    const values = () => [...all.tBodies[0].rows].map(row => row.cells[column].textContent);
    const before = values();
    all.tHead.rows[0].cells[column].querySelector("button").click();
    const rising = values();
    all.tHead.rows[0].cells[column].querySelector("button").click();
    const found = {{
      width: page.documentElement.scrollWidth, before, rising, falling: values(),
      images: [...page.images].map(image => [image.naturalWidth, image.width]),
    }};
    document.body.innerHTML = `<pre>${{JSON.stringify(found)}}</pre>`;
  }};
</script>
"""


@pytest.mark.skipif(BROWSER is None, reason="there is no Chromium here; on Debian: apt-get install chromium")
@pytest.mark.parametrize("width", [1280, 390])
def test_in_a_browser(folder, tmp_path, width):
    """At the width of a desktop and of a phone: nothing sticks out, figures are shown, tables sort."""
    page = html.escape((folder / "report.html").read_text())
    (tmp_path / "probe.html").write_text(PROBE.format(width=width, page=page))
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    command += ["--virtual-time-budget=20000", "--window-size=1400,1000", "--dump-dom"]
    shown = subprocess.run([*command, (tmp_path / "probe.html").as_uri()], capture_output=True, text=True).stdout
    match = re.search(r"<pre>(.*?)</pre>", shown, re.DOTALL)
    assert match, shown[:1000]
    found = json.loads(html.unescape(match[1]))
    assert found["width"] <= width
    assert all(natural > 100 and 100 < wide <= width for natural, wide in found["images"])

    def numbers(cells):
        return [np.inf if cell == "-" else float(cell) for cell in cells]

    assert len(found["before"]) == 15
    assert numbers(found["rising"]) == sorted(numbers(found["before"]))
    assert numbers(found["falling"]) == sorted(numbers(found["before"]), reverse=True)
    assert found["before"] != found["rising"]
