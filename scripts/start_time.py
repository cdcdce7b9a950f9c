"""How soon the package is there: seconds of CPU of fresh processes, the interpreter's own start included."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from statistics import median
from typing import Annotated

import typer
from one_sentence import one_sentence
from pages import save_table

from fvslam_graph.evaluation.tables import Table

TURNS = 5
FIRST_POSE = """
import sys
from fvslam_graph.core.config import load_config
from fvslam_graph.estimator import estimate
from fvslam_graph.pipeline import resolve_config
from fvslam_graph.sequences.open import open_sequence
sequence = open_sequence(sys.argv[1], frames="0:2")
list(estimate(sequence, resolve_config(load_config(settings=["mode=vo"]), sequence)))
"""


def main(
    path: Annotated[str, typer.Argument(help="Recording whose first pose is waited for.")],
    out: Annotated[Path, typer.Option(help="Folder for the table.")] = Path("runs") / "start_time",
) -> None:
    """Make a table of what is waited for; all take turns, medians."""
    starts = {
        "Python alone": ["-c", "pass"],
        "import fvslam_graph.pipeline": ["-c", "import fvslam_graph.pipeline"],
        "fvslam --help": ["-m", "fvslam_graph", "--help"],
        "first pose": ["-c", FIRST_POSE, path],
    }
    seconds: dict[str, list[float]] = {name: [] for name in starts}
    for turn in range(TURNS + 1):
        for name, arguments in starts.items():
            taken = _cpu_seconds(arguments)
            if turn:  # the first one compiles, and fills the caches
                seconds[name].append(taken)
    rows = [[name, f"{median(taken):.2f}"] for name, taken in seconds.items()]
    save_table(out, "start", Table(("", "CPU (s)"), rows))


def _cpu_seconds(arguments: list[str]) -> float:
    before = getrusage(RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    after = getrusage(RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
