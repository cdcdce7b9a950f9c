"""One run of a study: its row, and the folder that makes doing it again needless."""

import json
import math
import os
import shutil

import pytest

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.runs.run_folder import read_run
from fvslam_graph.study import jobs as job_module
from fvslam_graph.study.jobs import cached_row, execute
from fvslam_graph.study.sources import fingerprint

SIM3 = Alignment.SIM3


@pytest.mark.parametrize("mode", ["vo", "graph"])
def test_a_row_of_numbers(job, tmp_path, mode):
    one = job(f"mode={mode}", "seed=3", path="synthetic:uav?frames=24")
    row = execute(one, one.folder(tmp_path), SIM3)
    assert (row["mode"], row["preset"], row["seed"], row["scale_source"]) == (mode, "tuned", 3, "plane")
    assert (row["status"], row["coverage"], row["tracked"], row["associated"]) == ("finished", 1, 1, 24)
    assert 0 < row["ape"] < 0.1  # metres on 29 m; measured 0.01
    assert 25 < row["path"] < 35 and row["ms"] > 0 and 50 < row["peak_mb"] < 5000
    assert math.isnan(row["ape_smoothed"]) == math.isnan(row["matched"]) == (mode == "vo")


def test_what_was_done_is_not_done_again(job, tmp_path, monkeypatch):
    one = job()
    folder = one.folder(tmp_path)
    row = execute(one, folder, SIM3)
    monkeypatch.setattr(job_module, "run_sequence", None)  # cannot be called
    assert repr(execute(one, folder, SIM3)) == repr(row) == repr(cached_row(folder, SIM3))  # NaN differs from itself
    assert cached_row(folder, Alignment.ORIGIN) is None
    other = execute(one, folder, Alignment.ORIGIN)  # evaluated anew, and not run
    assert other["ape"] > row["ape"] and other["ms"] == row["ms"]


def test_an_unfinished_or_damaged_run_is_done_again(job, tmp_path):
    one = job()
    folder = one.folder(tmp_path)
    row = execute(one, folder, SIM3)
    info = json.loads((folder / "run.json").read_text())
    for content in (json.dumps(info | {"status": "running"}), "{"):
        (folder / "row_sim3.json").unlink()
        (folder / "run.json").write_text(content)
        again = execute(one, folder, SIM3)
        assert again["ape"] == row["ape"]
        assert read_run(folder).info["status"] == "finished"


def test_the_folder_depends_on_input_settings_and_version(job, drive, tmp_path, monkeypatch):
    recording = shutil.copytree(drive, tmp_path / "recording")
    first = job(path=str(recording)).folder(tmp_path)
    assert first.name.startswith("recording-vo-tuned-0-")
    assert job(path=str(recording)).folder(tmp_path) == first
    others = [
        job("seed=1", path=str(recording)),
        job("vo.min_inliers=21", path=str(recording)),
        job(path=str(recording), frames="0:5"),
        job(path=str(recording), camera_height=2.0),
        job(path=str(recording), preset="paper"),
    ]
    assert len({first, *(one.folder(tmp_path) for one in others)}) == 6

    os.utime(recording / "images" / "03.png", ns=(1, 1))
    fingerprint.cache_clear()
    changed = job(path=str(recording)).folder(tmp_path)
    assert changed != first
    monkeypatch.setattr(job_module, "code_version", lambda: ["another version"])
    assert job(path=str(recording)).folder(tmp_path) not in (first, changed)


def test_frames_are_those_asked_for(job, tmp_path):
    whole, half = job(), job(frames="0:6", name="half")
    rows = [execute(one, one.folder(tmp_path), SIM3) for one in (whole, half)]
    assert rows[1]["frames"] == 6 and rows[1]["path"] < 0.6 * rows[0]["path"]
    assert rows[1]["sequence"] == read_run(half.folder(tmp_path)).info["sequence"] == "half"


def test_without_ground_truth_there_are_no_errors(job, drive, tmp_path):
    recording = shutil.copytree(drive, tmp_path / "recording")
    (recording / "groundtruth.tum").unlink()
    one = job(path=str(recording))
    row = execute(one, one.folder(tmp_path), SIM3)
    assert (row["status"], row["coverage"]) == ("finished", 1)
    assert math.isnan(row["ape"]) and math.isnan(row["associated"])


def test_a_source_that_is_not_there(job, tmp_path):
    with pytest.raises(SequenceError, match="does not exist"):
        job(path=str(tmp_path / "absent")).folder(tmp_path)
