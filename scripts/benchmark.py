"""What an estimator costs on a sequence: CPU and wall time per frame, the floor below them, memory, growth.

The floor is the CPU time within the calls of OpenCV, PoseLib and GTSAM: what no other code around them could save.
Images are read outside of the time that is measured. Each mode runs in a process of its own, in turn with the others.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import wraps
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any

import cv2
import gtsam
import numpy as np
import psutil
import typer
from one_sentence import one_sentence
from rich.console import Console

from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.core.files import write_file, writing
from fvslam_graph.estimator import frame_estimator
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.features import ransac
from fvslam_graph.pipeline import resolve_config
from fvslam_graph.runs.provenance import peak_memory_mb, provenance
from fvslam_graph.sequences.open import open_sequence

WARM_UP = 5  # frames
PARTS = 8  # of the sequence, whose means tell whether a frame costs more the longer the path
GTSAM_CALLS = {
    gtsam.ISAM2: ("update", "calculateEstimate", "marginalCovariance", "marginalizeLeaves"),
    gtsam.LevenbergMarquardtOptimizer: ("optimize",),
    gtsam.GaussNewtonOptimizer: ("optimize",),
    gtsam.DoglegOptimizer: ("optimize",),
}
COLUMNS = ("mode", "CPU (ms)", "wall (ms)", "floor (ms)", "CPU/floor", "peak MB", "threads")


@dataclass(frozen=True)
class Cost:
    """What a run of a mode took.

    Attributes:
        mode: The estimator.
        cpu, wall, floor: Milliseconds per frame.
        peak_mb: Memory of its process.
        threads: Of its process.
        parts: CPU, milliseconds per frame, by eighths of the sequence.
        stages: Wall time, milliseconds per frame, by stage.
    """

    mode: str
    cpu: float
    wall: float
    floor: float
    peak_mb: float
    threads: int
    parts: list[float]
    stages: dict[str, float]


class Floor:
    """Counts the CPU time (seconds) within libraries, of the outermost call where one calls another."""

    def __init__(self) -> None:
        self.seconds, self._depth = 0.0, 0

    def within(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """The same call, counted."""

        @wraps(call)
        def counted(*arguments: Any, **options: Any) -> Any:
            begin, self._depth = time.process_time(), self._depth + 1
            try:
                return call(*arguments, **options)
            finally:
                self._depth -= 1
                self.seconds += 0.0 if self._depth else time.process_time() - begin

        return counted

    def watch(self) -> None:
        """Count from now on."""
        for module in filter(None, (cv2, ransac.poselib)):
            for name, call in vars(module).copy().items():
                if callable(call) and not isinstance(call, type) and not name.startswith("_"):
                    setattr(module, name, self.within(call))
        create = cv2.FastFeatureDetector_create
        cv2.FastFeatureDetector_create = lambda *arguments: _Detector(create(*arguments), self)
        for owner, names in GTSAM_CALLS.items():
            for name in filter(lambda name: hasattr(owner, name), names):
                setattr(owner, name, self.within(getattr(owner, name)))


class _Detector:
    """A corner detector whose calls are counted: OpenCV's own objects take no other methods."""

    def __init__(self, detector: cv2.FastFeatureDetector, floor: Floor) -> None:
        self.detect = floor.within(detector.detect)


def measure(path: str, mode: str, preset: str, settings: list[str], frames: str | None) -> Cost:
    """Run a mode once."""
    sequence = open_sequence(path, frames=frames)
    if len(sequence) <= WARM_UP:
        raise FvslamError(f"{sequence.name} has {len(sequence)} frames, but the first {WARM_UP} only warm up")
    cv2.setNumThreads(1)  # as `fvslam run`
    floor = Floor()
    floor.watch()
    config = resolve_config(load_config(preset, settings=[*settings, f"mode={mode}"]), sequence)
    estimator = frame_estimator(sequence, config)
    rows, stages = [], []
    for frame in sequence:
        before = np.array([time.process_time(), time.perf_counter(), floor.seconds])
        result = estimator.step(frame)
        rows.append(np.array([time.process_time(), time.perf_counter(), floor.seconds]) - before)
        stages.append(result.times)
    times = 1e3 * np.array(rows[WARM_UP:])
    cpu, wall, bare = map(float, times.mean(axis=0))
    return Cost(
        mode,
        cpu,
        wall,
        bare,
        peak_memory_mb(),
        psutil.Process().num_threads(),
        [float(part.mean()) for part in np.array_split(times[:, 0], PARTS)],
        {name: float(np.mean([stage[name] for stage in stages[WARM_UP:]])) for name in stages[0]},
    )


def summarise(costs: list[Cost]) -> Table:
    """A row for each mode: of its repetitions, that which took the least CPU was disturbed least."""
    best = [min((cost for cost in costs if cost.mode == mode), key=lambda cost: cost.cpu) for mode in _modes(costs)]
    rows = [
        [
            cost.mode,
            *(f"{value:.2f}" for value in (cost.cpu, cost.wall, cost.floor, cost.cpu / max(cost.floor, 1e-9))),
            f"{cost.peak_mb:.0f}",
            str(cost.threads),
            *(f"{part:.1f}" for part in cost.parts),
        ]
        for cost in best
    ]
    caption = "Per frame, without reading it; the eighths are CPU (ms). The repetition with the least CPU."
    return Table((*COLUMNS, *(f"eighth {n}" for n in range(1, PARTS + 1))), rows, 1, caption, keys=1)


def stage_table(costs: list[Cost]) -> Table:
    """Wall time by stage, a column for each mode."""
    modes = _modes(costs)
    found = {mode: [cost.stages for cost in costs if cost.mode == mode] for mode in modes}
    names = dict.fromkeys(name for cost in costs for name in cost.stages)
    rows = [
        [name, *(f"{min(s[name] for s in found[mode]):.2f}" if name in found[mode][0] else "-" for mode in modes)]
        for name in names
    ]
    return Table(("stage, wall (ms)", *modes), rows, 1, keys=1)


def kept_table(records: list[dict[str, Any]]) -> Table:
    """The runs that were kept, the newest last."""
    rows = [
        [record["date"], record["code"][:12], record["sequence"], cost["mode"]]
        + [f"{cost[name]:.2f}" for name in ("cpu", "floor")]
        + [f"{cost['peak_mb']:.0f}"]
        for record in records
        for cost in record["costs"]
    ]
    return Table(("date", "code", "sequence", "mode", "CPU (ms)", "floor (ms)", "peak MB"), rows, 4, keys=2)


def _modes(costs: list[Cost]) -> list[str]:
    return list(dict.fromkeys(cost.mode for cost in costs))


def main(
    path: Annotated[str, typer.Argument(help="As for `fvslam run`.")],
    modes: Annotated[str, typer.Option(help="Comma-separated; run in turn.")] = "vo,graph",
    preset: Annotated[str, typer.Option(help="paper or tuned.")] = "tuned",
    settings: Annotated[list[str] | None, typer.Option("--set", help="One setting, e.g. slam.landmarks=60.")] = None,
    frames: Annotated[str | None, typer.Option(help="Part of the sequence, START:STOP.", metavar="A:B")] = None,
    repeat: Annotated[int, typer.Option(help="How often each mode is run.", min=1)] = 3,
    keep: Annotated[Path | None, typer.Option(help="JSON file to which this measurement is added.")] = None,
    last: Annotated[int, typer.Option(help="How many kept ones are shown.")] = 5,
) -> None:
    """Print what modes cost, and add it to those that are kept."""
    todo = modes.split(",") * repeat
    context = get_context("spawn")  # a process for each run, whose memory is its own
    with ProcessPoolExecutor(1, mp_context=context, max_tasks_per_child=1) as pool:
        costs = list(pool.map(measure, *zip(*((path, m, preset, settings or [], frames) for m in todo), strict=True)))
    show = Console(highlight=False, markup=False)
    for table in (summarise(costs), stage_table(costs)):
        show.print(*table.rich(show.width), table.caption, sep="\n")
    if keep is not None:
        records = json.loads(keep.read_text()) if keep.exists() else []
        code = str(provenance().get("git", "unknown"))
        date = time.strftime("%Y-%m-%d %H:%M")
        records.append({"date": date, "code": code, "sequence": path, "costs": [asdict(cost) for cost in costs]})
        with writing(keep.parent):
            write_file(keep, json.dumps(records, indent=1))
        show.print(*kept_table(records[-last:]).rich(show.width))


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
