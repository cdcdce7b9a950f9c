"""Many runs in memory: each is a row of numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from typing import Any

import cv2
import numpy as np

from fvslam_graph.config import load_config
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.metrics import Evaluation, evaluate
from fvslam_graph.evaluation.runs import evaluation_of_results
from fvslam_graph.pipeline import applicable, estimate
from fvslam_graph.sequences.base import Sequence
from fvslam_graph.sequences.opening import open_sequence
from fvslam_graph.trajectory import Status


@dataclass(frozen=True)
class Job:
    """One run.

    Attributes:
        path: As for `open_sequence`.
        frames: Part of the sequence, START:STOP.
        preset: "paper" or "tuned".
        settings: "group.name=value" each.
        seed: Of all random numbers.
    """

    path: str
    frames: str | None = None
    preset: str = "tuned"
    settings: tuple[str, ...] = ()
    seed: int = 0


def execute(job: Job) -> dict[str, Any]:
    """Run and evaluate: APE after Sim(3) (m), RPE from frame to frame (m), drift (%, deg/100 m), NEES, time (ms).

    NaN stands for what the recording cannot tell.
    """
    cv2.setNumThreads(1)  # as many runs as cores go on at once
    sequence = _opened(job.path, job.frames)
    config = applicable(load_config(job.preset, settings=(*job.settings, f"seed={job.seed}")), sequence)
    results = list(estimate(sequence, config))
    times = np.array([sum(result.times.values()) - result.times["read"] for result in results])
    row = {
        "sequence": sequence.name,
        "mode": config.mode.value,
        "preset": job.preset,
        "seed": job.seed,
        "scale_source": config.scale.source.value,
        "coverage": len(results) / len(sequence),
        "tracked": np.mean([result.status in (Status.TRACKED, Status.STATIC) for result in results]),
        "matched": _mean([result.measures.get("matched", np.nan) for result in results]),
        "ms": times.mean(),
    }
    truth, graph = sequence.ground_truth, results[-1].graph
    if truth is None:
        return row
    row |= numbers(evaluation_of_results(results, truth, Alignment.SIM3, config.mode))
    smoothed = evaluate(graph.smoothed(), truth, Alignment.SIM3) if graph else None
    return row | {"ape_smoothed": smoothed.errors["ape_trans"].stats["rmse"] if smoothed else np.nan}


def numbers(evaluation: Evaluation) -> dict[str, float]:
    """The numbers of an evaluation that tables show."""
    nees = evaluation.consistency
    return {
        "ape": evaluation.errors["ape_trans"].stats["rmse"],
        "rpe": evaluation.errors["rpe_trans"].stats["rmse"],
        "t_rel": evaluation.drift.t_rel,
        "t_rel_scaled": evaluation.drift_scaled.t_rel,
        "r_rel": evaluation.drift.r_rel,
        "nees": np.nan if nees is None else nees.mean,
        "path": evaluation.association.reference.path_length,
    }


def execute_all(jobs: Iterable[Job], processes: int | None = None) -> Iterator[dict[str, Any]]:
    """The rows of all jobs in their order; `processes` at once, by default one a core."""
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        yield from pool.map(execute, jobs)


@cache
def _opened(path: str, frames: str | None) -> Sequence:
    return open_sequence(path, frames=frames)


def _mean(values: list[float]) -> float:
    known = np.array(values)[~np.isnan(values)]
    return float(known.mean()) if len(known) else float("nan")
