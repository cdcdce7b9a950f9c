"""The common part of the experiments: runs in parallel, and their outcome as CSV, Markdown and PNG."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import matplotlib
import numpy as np
import typer
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pages import save_table
from rich.console import Console
from rich.progress import track

from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.plots.style import STYLE
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.study.execution import execute_all
from fvslam_graph.study.jobs import Job
from fvslam_graph.study.sources import Source

Rows = list[dict[str, Any]]

SequencePath = Annotated[str, typer.Argument(help="As for `fvslam run`.")]
Out = Annotated[Path, typer.Option(help="Folder of the outcome.")]
Preset = Annotated[str, typer.Option(help="paper or tuned.")]
Frames = Annotated[str | None, typer.Option(help="Part of the sequence, START:STOP.", metavar="A:B")]
Seeds = Annotated[int, typer.Option(help="How many runs of each kind.", min=1)]


def job_of(path: str, frames: str | None, preset: str, settings: Iterable[str]) -> Job:
    """One run."""
    return Job(Source(path=path, frames=frames), load_config(preset, settings=list(settings)))


def run_all(jobs: Sequence[Job], out: Path, workers: int | None = None) -> Rows:
    """The rows of all jobs in their order, with a bar on a terminal; runs are kept in `out`/runs, and not done again.

    Raises:
        FvslamError: One of them failed.
    """
    rows = execute_all(jobs, out / "runs", Alignment.SIM3, workers)
    done = dict(track(rows, "runs", len(jobs), console=Console(stderr=True), transient=True))
    for row in done.values():
        if row["status"] != "finished":
            raise FvslamError(f"{row['mode']} on {row['sequence']} with seed {row['seed']} {row['status']}")
    return [done[number] for number in range(len(jobs))]


def run_variants(
    kind: str,
    variants: Mapping[Any, tuple[str, ...]],
    path: str,
    frames: str | None,
    preset: str,
    seeds: int,
    out: Path,
) -> dict[Any, Rows]:
    """The rows of each variant, one a seed; the variant itself is in the column `kind`."""
    jobs = [
        job_of(path, frames, preset, (*settings, f"seed={seed}"))
        for settings in variants.values()
        for seed in range(seeds)
    ]
    rows = iter(run_all(jobs, out))
    return {variant: [next(rows) | {kind: variant} for _ in range(seeds)] for variant in variants}


def column(rows: Iterable[dict[str, Any]], name: str) -> NDArray[np.float64]:
    """One number of each row."""
    return np.array([row[name] for row in rows], float)


def save(
    out: Path,
    experiment: str,
    name: str,
    rows: Rows,
    table: Table,
    draw: Callable[[Figure], None],
    size: tuple[int, int],
) -> None:
    """Write `<experiment>-<name>` as .csv, .md and .png, and print the table."""
    out.mkdir(parents=True, exist_ok=True)
    stem = out / re.sub(r"[^\w.-]+", "-", f"{experiment}-{name}")
    with stem.with_name(f"{stem.name}.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        figure.savefig(stem.with_name(f"{stem.name}.png"))
    save_table(out, stem.name, table)
    Console().print(f"{stem}.csv, .md, .png")
