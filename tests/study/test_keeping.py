"""A study keeps what is there: its own results, and everything of its user."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from fvslam_graph.core.errors import ResultsError, StudyError
from fvslam_graph.runs.ownership import FolderKind, claimed
from fvslam_graph.runs.run_folder import read_run
from fvslam_graph.study import jobs as job_module
from fvslam_graph.study import run as module
from fvslam_graph.study.execution import execute_all
from fvslam_graph.study.run import run_study
from fvslam_graph.study.sources import Source, fingerprint, render
from fvslam_graph.study.spec import Study, comparison, default_folder, load_study

TINY = "synthetic:uav?frames=12&size=160x120"


def study(**changes):
    return Study(**{"sequences": [TINY], "modes": ["vo"], "seeds": 1} | changes)


@pytest.fixture
def unplotted(monkeypatch):
    """Figures take longer than the runs."""
    monkeypatch.setattr(module, "draw_study", lambda *arguments: [])
    monkeypatch.setattr(module, "_draw_trajectories", lambda *arguments: [])


@pytest.mark.parametrize("names", [("uav_1", "uav-1"), ("飞行", "无人机")])
def test_sequences_whose_names_look_alike_have_their_own_images(tmp_path, names):
    paths = TINY, TINY + "&seed=3"
    sequences = [{"path": path, "name": name} for path, name in zip(paths, names, strict=True)]
    sequences.append({"path": TINY, "name": "again"})
    rows = dict(execute_all(study(sequences=sequences).jobs(), tmp_path / "runs", workers=1))
    assert [rows[n]["sequence"] for n in range(3)] == [*names, "again"]
    assert rows[0]["ape"] == rows[2]["ape"] != rows[1]["ape"]
    assert len({row["folder"] for row in rows.values()}) == len(list((tmp_path / "runs").iterdir())) == 3
    assert len({render(Source(**one), tmp_path) for one in sequences}) == 3


def test_a_name_of_any_length(tmp_path, unplotted):
    long = study(name="s" * 300, sequences=[{"path": TINY, "name": "x" * 300}])
    assert len(default_folder(long).name) < 100
    assert run_study(long, tmp_path / "out", 1).table["status"].tolist() == ["finished"]


def test_what_a_user_has_put_beside_the_runs_stays(tmp_path, unplotted):
    out = tmp_path / "out"
    run_study(study(), out, 1)
    for folder in (out / "images", out / "runs" / "rendered"):
        folder.mkdir()
        (folder / "mine.npz").write_text("mine")
    run_study(study(), out, 1)  # nothing is run, so that nothing is rendered
    with pytest.raises(ResultsError, match="rendered holds files that are not of a set of rendered images"):
        run_study(study(seeds=2), out, 1)
    assert [(folder / "mine.npz").read_text() for folder in (out / "images", out / "runs" / "rendered")] == 2 * ["mine"]


def test_a_study_in_a_folder_within_the_recording_is_gone_on_with(drive, tmp_path, monkeypatch, unplotted):
    """What it has written there is no part of the recording, of which the runs' folders carry a hash."""
    recording = shutil.copytree(drive, tmp_path / "recording")
    monkeypatch.chdir(recording)
    tables = []
    for _ in range(2):
        fingerprint.cache_clear()
        run_study(comparison(".", ["vo"], 1), Path("runs") / "cmp", 1)
        tables.append((recording / "runs" / "cmp" / "results.csv").read_bytes())
    assert tables[0] == tables[1] and b"recording" in tables[0]
    assert len(list((recording / "runs" / "cmp" / "runs").iterdir())) == 1


def test_two_studies_at_once(tmp_path, unplotted):
    script = (
        "import sys\nfrom pathlib import Path\nfrom fvslam_graph.runs.ownership import FolderKind, claimed\n"
        "with claimed(Path(sys.argv[1]), FolderKind.STUDY):\n    print('held', flush=True)\n    sys.stdin.read()\n"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "out")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        other.stdout.readline()
        with pytest.raises(ResultsError, match="out is in use by another process"):
            run_study(study(), tmp_path / "out", 1)
        other.kill()
    run_study(study(), tmp_path / "out", 1)


def test_a_declaration_means_the_same_wherever_it_is_read(drive, tmp_path, monkeypatch, unplotted):
    shutil.copytree(drive, tmp_path / "recording")
    monkeypatch.chdir(tmp_path)
    declared = comparison("recording", ["vo"], 1, external={"own": "recording/groundtruth.tum"})
    run_study(declared, Path("cmp"), 1)
    before = (tmp_path / "cmp" / "results.csv").read_bytes()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    again = load_study(tmp_path / "cmp" / "study.yaml")
    run_study(again, tmp_path / "cmp", 1)
    assert (tmp_path / "cmp" / "results.csv").read_bytes() == before
    assert len(list((tmp_path / "cmp" / "runs").iterdir())) == 1
    assert yaml.safe_load((tmp_path / "cmp" / "study.yaml").read_text())["sequences"][0]["path"].startswith("/")


def test_results_are_not_replaced_by_failures(drive, tmp_path, unplotted):
    recording = shutil.copytree(drive, tmp_path / "recording")
    files = {"recording": {"own": str(recording / "groundtruth.tum")}}
    declared = study(sequences=[str(recording)], external=files)
    run_study(declared, tmp_path / "out", 1)
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir() if path.is_file()}
    recording.rename(tmp_path / "unplugged")
    fingerprint.cache_clear()
    with pytest.raises(StudyError, match=r"1 of 1 runs fail that .* \(vo on recording: failed: .*exist"):
        run_study(declared, tmp_path / "out", 1)
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir() if path.is_file()} == before


def test_other_systems_are_looked_at_first(drive, tmp_path, monkeypatch, unplotted, caplog):
    """A bad one is a row that says why; none of it comes after an hour of runs."""
    (tmp_path / "ns.tum").write_text("".join(f"{1.5e18 + n * 1e8:.0f} 0 0 {n} 0 0 0 1\n" for n in range(12)))
    seen = []

    def execute(jobs, *arguments):
        seen.extend(caplog.messages)
        return execute_all(jobs, *arguments)

    monkeypatch.setattr(module, "execute_all", execute)
    files = {"absent": str(tmp_path / "absent.tum"), "ns": str(tmp_path / "ns.tum")}
    outcome = run_study(study(sequences=[str(drive)], external={drive.name: files}), tmp_path / "out", 1)
    assert len(seen) == 2 and "absent.tum" in seen[0] and "ns on drive: failed" in seen[1]
    assert outcome.table["status"].str.split(":").str[0].tolist() == ["finished", "failed", "failed"]
    failures = outcome.failures()
    assert all(isinstance(cell, str) for row in failures.rows for cell in row) and failures.rich(80)
    assert "ns.tum" in (tmp_path / "out" / "report.html").read_text() or "ns" in failures.rows[1]


def test_what_a_run_lacks_is_said(job, tmp_path, monkeypatch):
    from fvslam_graph.core.errors import EstimationError
    from fvslam_graph.graph.factor_graph import Graph
    from fvslam_graph.study.results import StudyResults

    def fails(self):
        raise EstimationError("it is singular")

    monkeypatch.setattr(Graph, "smoothed", fails)
    one = job("mode=graph", path=TINY)
    row = job_module.execute(one, tmp_path / "run", "sim3")
    assert row["status"] == "finished" and row["ape"] > 0 and np.isnan(row["ape_smoothed"])
    said = StudyResults.of([row], "sim3").failures().rows
    assert said[0][-1] == "finished, but the smoothed trajectory is not determined: it is singular"


def test_images_that_there_is_no_room_for_are_rendered_as_needed(tmp_path, monkeypatch):
    def full(*arguments, **named):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    assert render(Source(path=TINY), tmp_path) is None
    assert list(tmp_path.iterdir()) == []


def test_a_run_waits_for_whoever_is_at_it(job, tmp_path):
    """As a worker of a study that was killed; in another process, since a thread may claim a folder again."""
    one = job(path=TINY)
    folder = one.folder(tmp_path)
    script = (
        "import sys\nfrom pathlib import Path\nfrom fvslam_graph.runs.ownership import FolderKind, claimed\n"
        "with claimed(Path(sys.argv[1]), FolderKind.RUN):\n    print('held', flush=True)\n    sys.stdin.read()\n"
        "    (Path(sys.argv[1]) / 'row_sim3.json').write_text('{\"ape\": 7}')\n"
    )
    with subprocess.Popen([sys.executable, "-c", script, str(folder)], stdin=subprocess.PIPE, stdout=-1) as other:
        other.stdout.readline()
        other.stdin.close()
        with claimed(folder, FolderKind.RUN, wait=True):
            assert job_module.cached_row(folder, "sim3") == {"ape": 7}
        assert job_module.execute(one, folder, "sim3")["ape"] == 7


STUDY = """
name: stopped
sequences: ["synthetic:uav?frames=12&size=160x120", "synthetic:drive?frames=8&size=160x60"]
modes: [vo, graph]
seeds: 1
"""


@pytest.mark.parametrize(("stop", "runs"), [(signal.SIGKILL, 1), (signal.SIGTERM, 2), (signal.SIGINT, 3)])
def test_a_study_that_was_stopped_and_gone_on_with_equals_an_undisturbed_one(
    tmp_path_factory, unplotted, undisturbed, stop, runs
):
    """Stopped where it has begun so many runs; scripts/stop_anywhere.py does it anywhere."""
    folder = tmp_path_factory.mktemp("stopped")
    (folder / "study.yaml").write_text(STUDY)
    (folder / "sitecustomize.py").write_text(f"""
import os, signal, sys, threading
from fvslam_graph import pipeline
def stopped(estimator, sequence, through=pipeline.through):
    with open({str(folder / "begun")!r}, "a+") as begun:  # runs are processes of their own
        begun.write(".")
        begun.seek(0)
        number = len(begun.read())
    for result in through(estimator, sequence):
        if (number, result.index) == ({runs}, 5) and os.getppid() != {os.getpid()}:
            os.kill(os.getppid(), {int(stop)})
            threading.Event().wait(60)  # until the study that waits for this run is gone
        yield result
pipeline.through = stopped
""")
    script = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # which may be ignored where the tests are begun
from fvslam_graph import cli
from fvslam_graph.study import run
run.draw_study = run._draw_trajectories = lambda *arguments: []
import sys
sys.argv = ["fvslam", "study", "study.yaml", "--out", "out", "--workers", "1"]
cli.main()
"""
    environment = os.environ | {"PYTHONPATH": str(folder)}
    stopped = subprocess.run(
        [sys.executable, "-c", script], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert stopped.returncode == (-9 if stop is signal.SIGKILL else 130), stopped.stderr
    assert "Traceback" not in stopped.stderr
    states = [
        read_run(path).info["status"] for path in (folder / "out" / "runs").iterdir() if (path / "run.json").exists()
    ]
    assert states.count("finished") == runs - 1
    assert states.count("interrupted") == 1  # also where the study itself was killed
    run_study(load_study(folder / "study.yaml"), folder / "out", 1)
    assert (folder / "out" / "results.csv").read_bytes() == undisturbed
    assert pd.read_parquet(folder / "out" / "results.parquet")["status"].tolist() == 4 * ["finished"]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The results of that study."""
    folder = tmp_path_factory.mktemp("undisturbed")
    (folder / "study.yaml").write_text(STUDY)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "draw_study", lambda *arguments: [])
        patch.setattr(module, "_draw_trajectories", lambda *arguments: [])
        run_study(load_study(folder / "study.yaml"), folder / "out", 1)
    return (folder / "out" / "results.csv").read_bytes()


def test_a_report_of_the_same_results_is_not_made_again(drive, tmp_path, monkeypatch, unplotted):
    drawn = []
    monkeypatch.setattr(module, "draw_study", lambda *arguments: drawn.append(1) or [])
    declared = study(sequences=[str(drive)])
    tables = [run_study(declared, tmp_path, 1).table for _ in range(2)]
    pd.testing.assert_frame_equal(*tables)
    assert len(drawn) == 1
    (tmp_path / "report.html").unlink()
    run_study(declared, tmp_path, 1)
    run_study(declared.model_copy(update={"name": "another title"}), tmp_path, 1)
    assert len(drawn) == 3 and (tmp_path / "report.html").is_file()
