"""Many runs at once are the same as one after another, and none is lost or done twice."""

import shutil
import subprocess
import sys
import textwrap

import pytest

from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import StudyError
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.study import execution
from fvslam_graph.study.execution import execute_all
from fvslam_graph.study.jobs import Job, cached_row
from fvslam_graph.study.results import COSTS, RESULTS, StudyResults
from fvslam_graph.study.sources import Source, fingerprint

SIM3 = Alignment.SIM3


def table(rows):
    """What does not depend on the machine, bit for bit."""
    outcome = StudyResults.of([rows[number] for number in sorted(rows)], SIM3)
    return outcome.table[list(RESULTS)].to_csv(index=False)


@pytest.fixture(scope="module")
def jobs(job):
    return [job(f"mode={mode}", f"seed={seed}") for mode in ("vo", "average", "graph") for seed in (0, 1)]


@pytest.fixture(scope="module")
def serial(jobs, tmp_path_factory):
    return dict(execute_all(jobs, tmp_path_factory.mktemp("serial"), SIM3, workers=1))


def test_in_parallel_the_table_is_the_same(jobs, serial, tmp_path):
    parallel = dict(execute_all(jobs, tmp_path, SIM3, workers=2))
    assert table(parallel) == table(serial)
    assert len(serial) == len(jobs) and all(row["status"] == "finished" for row in serial.values())
    assert len({row["ape"] for row in serial.values()}) >= 3  # modes differ, seeds hardly
    assert not set(COSTS) & set(RESULTS)


def test_killed_and_started_again(jobs, serial, tmp_path, monkeypatch):
    script = textwrap.dedent("""
        import os, pickle, signal, sys
        from pathlib import Path
        from fvslam_graph.study.execution import execute_all

        if __name__ == "__main__":
            jobs = pickle.load(sys.stdin.buffer)
            for count, _ in enumerate(execute_all(jobs, Path(sys.argv[1]), workers=2), 1):
                if count == 2:
                    os.kill(os.getpid(), signal.SIGKILL)
    """)
    import pickle

    (tmp_path / "study.py").write_text(script)
    command = [sys.executable, str(tmp_path / "study.py"), str(tmp_path / "runs")]
    killed = subprocess.run(command, input=pickle.dumps(jobs), capture_output=True)
    assert killed.returncode == -9, killed.stderr.decode()
    folders = [one.folder(tmp_path / "runs") for one in jobs]
    done = {number for number, folder in enumerate(folders) if cached_row(folder, SIM3) is not None}
    assert 2 <= len(done) < len(jobs)

    executed = []

    def spy(one, *arguments, execute=execution.execute_apart):
        executed.append(jobs.index(one))
        return execute(one, *arguments)

    monkeypatch.setattr(execution, "execute_apart", spy)
    rows = dict(execute_all(jobs, tmp_path / "runs", SIM3, workers=1))
    assert sorted([*done, *executed]) == list(range(len(jobs)))
    assert table(rows) == table(serial)


def test_a_run_that_fails_is_a_row_with_its_reason(job, tmp_path, monkeypatch):
    jobs = [job(path=str(tmp_path / "absent")), job("scale.source=oracle"), job()]

    def fails(one, *arguments, execute=execution.execute_apart):
        if one.config.scale.source == "oracle":
            raise MemoryError
        return execute(one, *arguments)

    monkeypatch.setattr(execution, "execute_apart", fails)
    rows = dict(execute_all(jobs, tmp_path / "runs", SIM3, workers=1))
    assert rows[0]["status"] == f"failed: {tmp_path / 'absent'} does not exist"
    assert rows[1]["status"] == "failed: MemoryError"
    assert rows[2]["status"] == "finished"
    outcome = StudyResults.of([rows[number] for number in range(3)], SIM3)
    assert len(outcome.finished) == 1 and len(outcome.failures().rows) == 2


def test_a_cluster_that_exists(jobs, serial, tmp_path):
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0") as cluster:
        rows = dict(execute_all(jobs[:2], tmp_path, SIM3, scheduler=cluster.scheduler_address))
    assert table(rows) == table({number: serial[number] for number in rows})


def test_a_cluster_that_does_not(jobs, tmp_path, monkeypatch):
    monkeypatch.setattr(execution, "SCHEDULER_TIMEOUT", "100ms")
    with pytest.raises(StudyError, match="no dask scheduler answers at 'tcp"):
        dict(execute_all(jobs[:1], tmp_path, SIM3, scheduler="tcp://127.0.0.1:9"))


@pytest.mark.parametrize("address", ["foo", "http://x", "", "tcp://"])
def test_an_address_that_is_none(jobs, tmp_path, address):
    with pytest.raises(StudyError, match=f"no dask scheduler answers at '{address}'; start one") as caught:
        dict(execute_all(jobs[:1], tmp_path, SIM3, scheduler=address))
    assert "\n" not in str(caught.value)


def test_a_worker_with_another_recording_does_not_run_it(tmp_path, drive, monkeypatch):
    """Or with another version of a library, which counts likewise."""
    recording = shutil.copytree(drive, tmp_path / "drive")
    job = Job(Source(path=str(recording)), load_config())
    folder = job.folder(tmp_path / "runs")
    assert execution._on_worker(job, folder, SIM3, None)["status"] == "finished"
    (recording / "camera.yaml").touch()
    fingerprint.cache_clear()
    row = execution._on_worker(job, folder, SIM3, None)
    assert "the recording, this package or a library of it is another one" in row["status"]
