"""One run of a study: what it depends on, where it is kept, and the row of numbers that comes out."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fvslam_graph.core.config import Config
from fvslam_graph.core.errors import FvslamError, ResultsError
from fvslam_graph.core.files import MAX_NAME_LENGTH, one_line, write_json, writing
from fvslam_graph.core.plugins import Plugin, source_hash
from fvslam_graph.core.text_files import read_text
from fvslam_graph.core.trajectory import Status
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.metrics import Evaluation
from fvslam_graph.evaluation.runs import evaluate_run
from fvslam_graph.pipeline import run_sequence
from fvslam_graph.runs.ownership import FolderKind, claimed
from fvslam_graph.runs.provenance import library_versions
from fvslam_graph.runs.results import Run
from fvslam_graph.runs.run_folder import read_run
from fvslam_graph.study.sources import Source, fingerprint, opened

VARIANT_SEPARATOR = ", "  # between the settings of a variant

Row = dict[str, Any]
"""One run as numbers and words, by column; see `row_of`."""


@dataclass(frozen=True)
class Job:
    """One run.

    Attributes:
        source: What it runs on.
        config: All settings, the mode and the seed among them.
        variant: What sets it apart from other runs of the same mode, in words; "" where nothing does.
        method: A function of a sequence and a seed, which runs in place of the mode; this is its name then.
    """

    source: Source
    config: Config
    variant: str = ""
    method: Plugin | None = None

    @property
    def is_reproducible(self) -> bool:
        """Whether its hash tells all that numbers depend on, and another process can do it."""
        return self.method is None or self.method.origin["source"] is not None

    def folder(self, runs: Path) -> Path:
        """Where it is kept below `runs`: the name ends with a hash of input, settings and version.

        Raises:
            FvslamError: The source cannot be opened.
        """
        depends_on: list[Any] = [
            self.source.label,
            fingerprint(self.source),
            code_version(),
            self.config.model_dump_json(),
        ]
        depends_on += [self.config.origins, self.method and self.method.origin]
        digest = hashlib.blake2b(json.dumps(depends_on).encode(), digest_size=8).hexdigest()
        parts = (self.source.label, self.config.mode, self.config.preset, self.variant, self.config.seed)
        slug = re.sub(r"[^a-zA-Z0-9.]+", "-", "-".join(str(part) for part in parts if part != ""))
        return runs / f"{slug[:MAX_NAME_LENGTH].strip('-.')}-{digest}"

    def labels(self) -> Row:
        """The columns that say which run a row is."""
        return {
            "sequence": self.source.label,
            "mode": self.config.mode,
            "preset": str(self.config.preset),
            "variant": self.variant,
            "seed": self.config.seed,
        }


def execute(job: Job, folder: Path, align: Alignment, rendered: Path | None = None) -> Row:
    """Run, unless the folder holds the finished run, and evaluate; the row is kept in the folder, too.

    Args:
        job: The run.
        folder: Of the run.
        align: For the evaluation.
        rendered: What `render` returned for the source; without it, images are read or rendered one by one.

    Raises:
        FvslamError: The source cannot be opened or the folder not written.
    """
    with claimed(folder, FolderKind.RUN, wait=True):  # of a study that was killed, a worker may still be at it
        if job.is_reproducible and (row := cached_row(folder, align)) is not None:
            return row
        if not (job.is_reproducible and _finished(folder)):
            run_sequence(opened(job.source, rendered), job.config, folder, method=job.method)
        run = read_run(folder)
        evaluation = evaluate_run(folder, align=align) if run.ground_truth is not None else None
        row = job.labels() | row_of(run, evaluation) | {"folder": folder.name}
        with writing(folder):
            write_json(_row_file(folder, align), row)
        return row


def cached_row(folder: Path, align: Alignment) -> Row | None:
    """The row of a run that was done and evaluated before; None where it was not."""
    try:
        row = json.loads(read_text(_row_file(folder, align), ResultsError))
    except (ResultsError, ValueError, RecursionError):
        return None
    if not isinstance(row, dict):
        return None
    # JSON has no word for what is not a number.
    return {key: np.nan if value is None else value for key, value in row.items()}


def row_of(run: Run, evaluation: Evaluation | None) -> Row:
    """The row of a run in tables.

    Errors are those of the online trajectory after alignment: `ape` (m), `ape_rot` (deg), `rpe` from frame to frame (m)
    and `rpe_1m` over a metre, all RMSE; `ape_smoothed` (m); drift `t_rel` (%) and `r_rel` (deg/100 m) without scale
    correction, `t_rel_scaled` with it; `nees` of the relative motions, of their rotations and of their directions, and
    which of these the reference cannot judge (`unjudged`). `matched` is how many landmarks V-SLAM finds in an image,
    `nis` the mean normalised innovation squared of those it takes, `ms` the mean time of a frame without reading it,
    `cpu_s` and `wall_s` the seconds of the whole run with reading, `peak_mb` the memory of the process, `waited` the
    share of its time for which it waited for a core. NaN stands for what the recording cannot tell.
    """
    status, times = run.frames["status"], [run.frames[name] for name in run.frames if name.endswith("_ms")]
    milliseconds = np.sum(times, axis=0) - run.frames.get("read_ms", 0.0)
    totals = run.info.get("totals", {})
    row: Row = {
        "status": run.info["status"],
        "frames": run.info["frames"],
        "scale_source": run.info["scale_source"],
        "coverage": run.coverage,
        "tracked": float(np.isin(status, (Status.TRACKED, Status.STATIC)).mean()),
        "matched": _mean(run, "matched"),
        "nis": _mean(run, "nis"),
        "note": _note(run),
        "ms": float(np.mean(milliseconds)),
        "ms_p95": float(np.percentile(milliseconds, 95)),
        "cpu_s": totals.get("cpu_seconds", np.nan),
        "wall_s": totals.get("seconds", np.nan),
        "peak_mb": totals.get("peak_memory_mb", np.nan),
        "waited": totals.get("waited", np.nan),
    }
    if evaluation is None:
        return row | dict.fromkeys(METRIC_COLUMNS, np.nan) | {"unjudged": ""}
    return row | metric_columns(evaluation)


def metric_columns(evaluation: Evaluation) -> Row:
    """The numbers of an evaluation that tables show; see `row_of`."""
    nees = {part: found.mean for part, found in evaluation.nees.items() if found.judged}
    return {
        "ape": _rmse(evaluation, "ape_trans"),
        "ape_rot": _rmse(evaluation, "ape_rot"),
        "rpe": _rmse(evaluation, "rpe_trans"),
        "rpe_1m": _rmse(evaluation, "rpe_1m_trans"),
        "t_rel": evaluation.drift.t_rel,
        "t_rel_scaled": evaluation.drift_scaled.t_rel,
        "r_rel": evaluation.drift.r_rel,
        "scale": evaluation.scale,
        "nees": nees.get("pose", np.nan),
        "nees_rotation": nees.get("rotation", np.nan),
        "nees_direction": nees.get("direction", np.nan),
        "path": evaluation.pairs.reference.path_length,
        "associated": len(evaluation.pairs.indices),
        "ape_smoothed": evaluation.smoothed,
        "unjudged": ", ".join(part for part, found in evaluation.nees.items() if not found.judged),
    }


def outcome_line(row: Row) -> str:
    """One line on a run: which, and how it ended."""
    seed = f"seed {row['seed']}" if "seed" in row else ""  # other systems have none
    labels = [f"{row['mode']} on {row['sequence']}", row["variant"], seed]
    ape = row.get("ape", np.nan)
    said = f"APE {ape:.4g} m" if row["status"] == "finished" and np.isfinite(ape) else row["status"]
    return one_line(f"{', '.join(label for label in labels if label)}: {said}")


METRIC_COLUMNS = (
    "ape",
    "ape_rot",
    "rpe",
    "rpe_1m",
    "t_rel",
    "t_rel_scaled",
    "r_rel",
    "scale",
    "nees",
    "nees_rotation",
    "nees_direction",
    "path",
    "associated",
    "ape_smoothed",
)


def _note(run: Run) -> str:
    """A note that a reader of the table has to know of a run that came to its end."""
    smoothed = run.info.get("smoothed") or ""
    return f"the smoothed trajectory is {smoothed}" if smoothed.startswith("not determined") else ""


def _mean(run: Run, column: str) -> float:
    """The mean of a column over the frames that have it; NaN where none has."""
    values = run.frames.get(column, np.array(np.nan))
    return float(np.nanmean(values)) if np.isfinite(values).any() else np.nan


def _rmse(evaluation: Evaluation, name: str) -> float:
    return float(evaluation.errors[name].stats["rmse"]) if name in evaluation.errors else np.nan


def _row_file(folder: Path, align: Alignment) -> Path:
    return folder / f"row_{align}.json"


def _finished(folder: Path) -> bool:
    try:
        return bool(read_run(folder).info["status"] == "finished")
    except FvslamError:  # none yet, or damaged since: it is done again
        return False


def code_version() -> list[Any]:
    """The version of everything that computes: libraries by their number, this package by its source."""
    return [source_hash("fvslam_graph"), library_versions()]
