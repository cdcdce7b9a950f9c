"""A run in a process of its own answers for itself alone."""

import numpy as np
import pytest

from fvslam_graph.core.errors import StudyError
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.study.process import Running, execute_apart
from fvslam_graph.study.results import StudyResults

SIM3 = Alignment.SIM3


def test_its_memory_is_its_own(job, tmp_path):
    ballast = np.ones(100_000_000)  # 800 MB of this process
    one = job()
    row = execute_apart(one, one.folder(tmp_path), SIM3, None, Running())
    assert 50 < row["peak_mb"] < 600 and ballast[-1] == 1  # measured 190
    assert 0 <= row["waited"] < 1 or np.isnan(row["waited"])


def test_one_that_fails_says_why(job, tmp_path):
    one = job("scale.source=oracle", path=str(tmp_path / "absent"))
    with pytest.raises(StudyError, match="absent does not exist"):
        execute_apart(one, tmp_path / "run", SIM3, None, Running())


def test_one_that_dies_takes_nothing_with_it(job, tmp_path, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text("import os\nos._exit(9)\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(StudyError, match="its process ended with code 9"):
        execute_apart(job(), tmp_path / "run", SIM3, None, Running())


@pytest.mark.parametrize(
    ("waited", "said"), [(0.01, "images, undisturbed."), (0.4, "for one up to 40 % of the time."), (np.nan, "images.")]
)
def test_tables_say_whether_cores_were_shared(waited, said):
    row = {"sequence": "a", "mode": "vo", "preset": "tuned", "variant": "", "seed": 0, "status": "finished"}
    assert StudyResults.of([row | {"waited": waited}], SIM3).caption.endswith(said)
