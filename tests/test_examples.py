"""Every example runs, on little, and is short."""

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
SMALL = "synthetic:uav?frames=12&size=320x240"
ARGUMENTS = {
    "compare_modes": [SMALL],
    "grid_study": ["runs", 8, 1],
    "own_estimator": [SMALL, "runs"],
    "own_rule": [SMALL, "runs"],
    "run_and_evaluate": [SMALL],
}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_it_runs(example, tmp_path, monkeypatch, capfd, undrawn):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(example), *map(str, ARGUMENTS.get(example.stem, []))])
    names = runpy.run_path(str(example), run_name="__main__")
    for name in filter(lambda name: name.startswith("test_"), names):
        names[name]()
    out = capfd.readouterr().out
    assert " m" in out or "report.html" in out
    assert len(example.read_text().splitlines()) < 40


def test_there_are_some():
    assert len(EXAMPLES) >= 8
