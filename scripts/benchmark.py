"""How long an estimator takes on a sequence: milliseconds per frame by stage, frames per second, peak memory.

The first frames warm caches up and are left out. Times of several repetitions are pooled. Means over the quarters of
the sequence, Q1 to Q4, tell whether a stage takes longer the longer the path.
"""

from __future__ import annotations

import csv
import os
import sys
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from fvslam_graph.core.config import Config, load_config
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.core.files import writing
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.estimator import estimate, stages
from fvslam_graph.pipeline import resolve_config
from fvslam_graph.runs.provenance import peak_memory_mb
from fvslam_graph.sequences.open import open_sequence

WARM_UP = 5  # frames
STATISTICS = ("median", "mean", "p95", "Q1", "Q2", "Q3", "Q4")
TOTALS = ("without reading", "with reading")


def benchmark(
    path: Annotated[str, typer.Argument(help="As for `fvslam run`.")],
    preset: Annotated[str, typer.Option(help="paper or tuned.")] = "tuned",
    settings: Annotated[list[str] | None, typer.Option("--set", help="One setting, e.g. mode=vslam.")] = None,
    frames: Annotated[str | None, typer.Option(help="Part of the sequence, START:STOP.", metavar="A:B")] = None,
    repeat: Annotated[int, typer.Option(help="How often the sequence is run.", min=1)] = 1,
    csv_file: Annotated[Path | None, typer.Option("--csv", help="Write the table to this file, too.")] = None,
) -> None:
    """Print milliseconds per frame by stage, frames per second and peak memory."""
    sequence = open_sequence(path, frames=frames)
    if len(sequence) <= WARM_UP:
        raise FvslamError(f"{sequence.name} has {len(sequence)} frames, but the first {WARM_UP} only warm up")
    config = resolve_config(load_config(preset, settings=settings or []), sequence)
    rows = summarise(stages(config), np.stack([measure(sequence, config) for _ in range(repeat)], axis=1))

    camera = sequence.camera
    table = Table(
        title=f"{sequence.name}, {camera.width}x{camera.height}, mode {config.mode}, preset {preset}, "
        f"scale by {config.scale.source}",
        caption=f"{len(sequence) - WARM_UP} frames after {WARM_UP} of warm-up, {repeat} x, {os.cpu_count()} cores; "
        f"peak memory {peak_memory_mb():.0f} MB",
    )
    for column in ("ms per frame", *STATISTICS, "frames/s"):
        table.add_column(column, justify="left" if column == "ms per frame" else "right")
    for stage, numbers in rows.items():
        rate = f"{1e3 / numbers[STATISTICS.index('mean')]:.1f}" if stage in TOTALS else ""
        table.add_row(stage, *(f"{number:.2f}" for number in numbers), rate, end_section=stage == "other")
    Console().print(table)
    if csv_file is not None:
        with writing(csv_file.parent), csv_file.open("w", newline="") as file:
            csv.writer(file).writerows([("stage", *(f"{name}_ms" for name in STATISTICS))])
            csv.writer(file).writerows((stage, *(f"{number:.4f}" for number in rows[stage])) for stage in rows)


def measure(sequence: Sequence, config: Config) -> NDArray[np.float64]:
    """Milliseconds (frames, stages + 1) of each stage and, last, of the whole frame, after the warm-up."""
    times = []
    last = time.perf_counter()
    for result in estimate(sequence, config):
        now = time.perf_counter()
        times.append([*(result.times[stage] for stage in stages(config)), 1e3 * (now - last)])
        last = time.perf_counter()
    return np.array(times[WARM_UP:])


def summarise(names: tuple[str, ...], times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Statistics by stage, of what is in no stage, and of frames without and with reading.

    Args:
        names: Of the stages.
        times: (frames, repetitions, stages + 1), see `measure`.
    """
    *parts, total = np.moveaxis(times, -1, 0)
    columns = dict(zip(names, parts, strict=True))
    columns |= {"other": total - sum(parts), TOTALS[0]: total - columns["read"], TOTALS[1]: total}
    return {
        stage: np.array(
            [
                *(np.median(column), column.mean(), np.percentile(column, 95)),
                *(quarter.mean() for quarter in np.array_split(column, 4)),
            ]
        )
        for stage, column in columns.items()
    }


if __name__ == "__main__":
    try:
        typer.run(benchmark)
    except FvslamError as error:
        sys.exit(f"benchmark: {error}")
