"""Every example runs, and is short."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_it_runs(example, tmp_path):
    tested = example.stem.startswith("test_")
    command = [sys.executable, *(("-m", "pytest", "-p", "no:cacheprovider", "-s") if tested else ()), str(example)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert " m" in done.stdout or "report.html" in done.stdout
    assert len(example.read_text().splitlines()) < 40


def test_there_are_some():
    assert len(EXAMPLES) >= 4
