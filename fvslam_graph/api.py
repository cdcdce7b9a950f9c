"""The package from Python: run an estimator, evaluate a trajectory, compare modes."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fvslam_graph.core.config import Mode, load_config
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.metrics import Evaluation
from fvslam_graph.evaluation.runs import evaluation_of
from fvslam_graph.pipeline import run_sequence
from fvslam_graph.runs.results import Run
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.study.results import StudyResults
from fvslam_graph.study.run import run_study
from fvslam_graph.study.spec import comparison, default_folder


def run(
    sequence: Sequence | str | Path,
    mode: str = "vo",
    preset: str = "tuned",
    settings: Mapping[str, Any] | None = None,
    seed: int = 0,
    out: str | Path | None = None,
) -> Run:
    """Run an estimator on a sequence.

    Args:
        sequence: As `open_sequence` returns it, or what it takes: a folder, a video or `synthetic:uav`.
        mode: "vo", "vslam", "average", "intersection" or "graph".
        preset: "paper" or "tuned".
        settings: What differs from the preset, such as {"scale.source": "map"}.
        seed: Of all random numbers.
        out: Folder of the run; without it, nothing is written.

    Returns:
        Trajectories, covariances, a table of all frames, and the ground truth that `evaluate` takes.

    Raises:
        FvslamError: One sentence on what is missing, unknown or out of range.
    """
    recording = sequence if isinstance(sequence, Sequence) else open_sequence(sequence)
    changes = [f"{name}={json.dumps(value)}" for name, value in (settings or {}).items()]
    config = load_config(preset, settings=[f"mode={mode}", f"seed={seed}", *changes])
    return run_sequence(recording, config, None if out is None else Path(out))


def evaluate(
    estimated: Run | Trajectory | str | Path,
    reference: Trajectory | str | Path | None = None,
    align: str = "se3",
    time_offset: float = 0.0,
) -> Evaluation:
    """Compare a trajectory with its ground truth: APE and RPE (evo), drift (KITTI), NEES.

    Args:
        estimated: A run, a trajectory, a run folder, or a file in TUM's, KITTI's or the ASL layout.
        reference: A trajectory or its file; a run knows its own.
        align: "none", "origin", "se3" or "sim3".
        time_offset: Seconds, added to the stamps of the estimate to get those of the reference (evo's --t_offset).

    Raises:
        FvslamError: A file cannot be read, there is no reference, or the two have no time in common.
    """
    return evaluation_of(estimated, reference, align, time_offset)


def compare(
    sequence: str | Path,
    modes: Iterable[str] = tuple(Mode),
    seeds: int | Iterable[int] = 5,
    preset: str = "tuned",
    settings: Mapping[str, Any] | None = None,
    external: Mapping[str, str | Path] | None = None,
    align: str = "sim3",
    out: str | Path | None = None,
    workers: int = 1,
) -> StudyResults:
    """Run several modes on one sequence, over several seeds, beside the trajectories of other systems.

    Args:
        sequence: A folder, a video or `synthetic:uav`.
        modes: Which.
        seeds: How many, or which.
        preset: "paper" or "tuned".
        settings: What differs from the preset; a list of values makes a variant of each.
        external: Trajectory files by the name of their system; see `fvslam_graph.study.external.external_run`.
        align: "none", "origin", "se3" or "sim3".
        out: Folder for runs, tables, figures and report; runs/compare-... if not given. Runs that it holds are kept.
        workers: Processes at once; with several, times are those of runs that share the machine.

    Returns:
        `table` is a pandas DataFrame with a row for each run, `summary()` the table of medians.

    Raises:
        FvslamError: One sentence on what is missing, unknown or out of range.
    """
    study = comparison(sequence, modes, seeds, preset, settings, external, align)
    return run_study(study, default_folder(study) if out is None else Path(out), workers)
