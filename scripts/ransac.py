"""Odometry by PoseLib's RANSAC and by OpenCV's, which replaces it where it has no wheel: errors and time, in turn."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Annotated

import cv2
import typer
from one_sentence import one_sentence
from pages import save_table
from threadpoolctl import threadpool_limits

from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.estimator import estimate
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.metrics import evaluate
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.features import ransac
from fvslam_graph.pipeline import resolve_config
from fvslam_graph.sequences.open import open_sequence

LIBRARIES = {"PoseLib": ransac.poselib, "USAC": None}


def main(
    paths: Annotated[list[str], typer.Argument(help="Recordings with ground truth.")],
    seeds: Annotated[int, typer.Option(help="How many runs of each.", min=1)] = 3,
    out: Annotated[Path, typer.Option(help="Folder for the table.")] = Path("runs") / "ransac",
) -> None:
    """Make a table: APE after Sim3 (m), median and largest over the seeds, and milliseconds of CPU a frame."""
    cv2.setNumThreads(1)
    columns = [f"{name}, {what}" for what in ("APE", "largest", "ms") for name in LIBRARIES]
    rows = []
    for path in paths:
        sequence = open_sequence(path)
        runs: dict[str, list[tuple[float, float]]] = {name: [] for name in LIBRARIES}
        for seed in range(seeds):
            for name, library in LIBRARIES.items():
                ransac.poselib = library
                runs[name].append(_run(sequence, seed))
        of: list[Callable[[list[tuple[float, float]]], str]] = [
            lambda run: f"{median(ape for ape, _ in run):.2g}",
            lambda run: f"{max(ape for ape, _ in run):.2g}",
            lambda run: f"{median(ms for _, ms in run):.1f}",
        ]
        rows.append([Path(path).name, *(cell(runs[name]) for cell in of for name in LIBRARIES)])
    save_table(out, "ransac", Table(("recording", *columns), rows))


def _run(sequence: Sequence, seed: int) -> tuple[float, float]:
    """APE (m) and milliseconds of CPU a frame of one run."""
    if sequence.ground_truth is None:
        raise FvslamError(f"{sequence.name} has no ground truth to compare with")
    config = resolve_config(load_config(settings=[f"seed={seed}"]), sequence)
    begin = time.process_time()
    with threadpool_limits(1):
        poses = tuple(result.pose.mean for result in estimate(sequence, config))
    ms = 1000 * (time.process_time() - begin) / len(sequence)
    errors = evaluate(Trajectory(sequence.stamps, poses), sequence.ground_truth, Alignment.SIM3).errors
    return errors["ape_trans"].stats["rmse"], ms


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
