"""One run of a study: what it depends on, where it is kept, and the row of numbers that comes out."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt

import fvslam_graph
from fvslam_graph.core.config import Config
from fvslam_graph.core.errors import FvslamError, ResultsError
from fvslam_graph.core.files import MAX_NAME_LENGTH, file_name, one_line, replacing, write_json, writing
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.text_files import read_text
from fvslam_graph.core.trajectory import Status
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.metrics import Evaluation
from fvslam_graph.evaluation.runs import evaluate_run
from fvslam_graph.pipeline import run_sequence
from fvslam_graph.runs.ownership import Kind, claimed, kind_of
from fvslam_graph.runs.provenance import forget_peak_memory, provenance
from fvslam_graph.runs.results import Run
from fvslam_graph.runs.run_folder import read_run
from fvslam_graph.sequences.open import open_sequence

MAX_RENDERED_SIZE = 2e9  # bytes of rendered images

Row = dict[str, Any]
"""One run as numbers and words, by column; see `row_of`."""


class Source(BaseModel):
    """A recording or a synthetic world, as `open_sequence` takes it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    path: str
    name: str | None = None  # in tables; the sequence's own, if not given
    frames: str | None = None
    stride: PositiveInt = 1
    scale: float = Field(1.0, gt=0, le=1)
    camera_height: PositiveFloat | None = None
    camera_pitch: float | None = None
    camera_k1: float | None = None
    topic: str | None = None

    @property
    def label(self) -> str:
        """The name in tables, also where the recording cannot be opened."""
        return self.name or (self.path if self.path.startswith("synthetic:") else Path(self.path).absolute().name)

    def open(self) -> Sequence:
        """The sequence; raises as `open_sequence` does."""
        options = self.model_dump(exclude={"name"})
        if not self.path.startswith("synthetic:"):
            options["path"] = str(Path(self.path).expanduser().absolute())
        return replace(open_sequence(**options), name=self.label)


@dataclass(frozen=True)
class Job:
    """One run.

    Attributes:
        source: What it runs on.
        config: All settings, the mode and the seed among them.
        variant: What sets it apart from other runs of the same mode, in words; "" where nothing does.
    """

    source: Source
    config: Config
    variant: str = ""

    def folder(self, runs: Path) -> Path:
        """Where it is kept below `runs`: the name ends with a hash of input, settings and version.

        Raises:
            FvslamError: The source cannot be opened.
        """
        depends_on = [self.source.label, _fingerprint(self.source), _code(), self.config.model_dump_json()]
        digest = hashlib.blake2b(json.dumps(depends_on).encode(), digest_size=8).hexdigest()
        parts = (self.source.label, self.config.mode, self.config.preset, self.variant, self.config.seed)
        slug = re.sub(r"[^a-zA-Z0-9.]+", "-", "-".join(str(part) for part in parts if part != ""))
        return runs / f"{slug[:MAX_NAME_LENGTH].strip('-.')}-{digest}"

    def labels(self) -> Row:
        """The columns that say which run a row is."""
        return {
            "sequence": self.source.label,
            "mode": self.config.mode.value,
            "preset": self.config.preset,
            "variant": self.variant,
            "seed": self.config.seed,
        }


def render(source: Source, folder: Path) -> Path | None:
    """Render the images of a synthetic world into a file, since that takes longer than a run on them.

    Returns:
        The file; None for recordings, and for worlds that there is no room to keep.
    """
    sequence = source.open()
    size = (len(sequence), sequence.camera.height, sequence.camera.width)
    if not source.path.startswith("synthetic:") or np.prod(size) > MAX_RENDERED_SIZE:
        return None
    file = folder / f"{file_name(source.label)}.npz"
    try:
        images, usable = np.zeros(size, np.uint8), np.zeros(len(sequence), bool)
        for index in range(len(sequence)):
            image = sequence.load(index)
            if image is not None:
                images[index], usable[index] = image, True
        with replacing(file) as path:
            np.savez(path, images=images, usable=usable)
    except (OSError, ValueError, MemoryError):  # no room; zipfile complains of its own handle, too
        return None
    return file


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
    with claimed(folder, Kind.RUN, wait=True):  # of a study that was killed, a worker may still be at it
        if (row := cached_row(folder, align)) is not None:
            return row
        if not _finished(folder):
            sequence = _opened(job.source, rendered)
            forget_peak_memory()
            run_sequence(sequence, job.config, folder)
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
    correction, `t_rel_scaled` with it; `nees` of the relative motions. `matched` is how many landmarks V-SLAM finds in
    an image, `ms` the mean time of a frame without reading it, `peak_mb` the memory of the process. NaN stands for
    what the recording cannot tell.
    """
    status, times = run.frames["status"], [run.frames[name] for name in run.frames if name.endswith("_ms")]
    milliseconds = np.sum(times, axis=0) - run.frames.get("read_ms", 0.0)
    matched = run.frames.get("matched", np.array(np.nan))
    row: Row = {
        "status": run.info["status"],
        "frames": run.info["frames"],
        "scale_source": run.info["scale_source"],
        "coverage": run.coverage,
        "tracked": float(np.isin(status, (Status.TRACKED, Status.STATIC)).mean()),
        "matched": float(np.nanmean(matched)) if np.isfinite(matched).any() else np.nan,
        "note": _note(run),
        "ms": float(np.mean(milliseconds)),
        "ms_p95": float(np.percentile(milliseconds, 95)),
        "peak_mb": run.info.get("totals", {}).get("peak_memory_mb", np.nan),
    }
    if evaluation is None:
        return row | dict.fromkeys(METRIC_COLUMNS, np.nan)
    return row | metric_columns(evaluation)


def metric_columns(evaluation: Evaluation) -> dict[str, float]:
    """The numbers of an evaluation that tables show; see `row_of`."""
    nees = evaluation.consistency
    return {
        "ape": _rmse(evaluation, "ape_trans"),
        "ape_rot": _rmse(evaluation, "ape_rot"),
        "rpe": _rmse(evaluation, "rpe_trans"),
        "rpe_1m": _rmse(evaluation, "rpe_1m_trans"),
        "t_rel": evaluation.drift.t_rel,
        "t_rel_scaled": evaluation.drift_scaled.t_rel,
        "r_rel": evaluation.drift.r_rel,
        "scale": evaluation.scale,
        "nees": np.nan if nees is None else nees.mean,
        "path": evaluation.pairs.reference.path_length,
        "associated": len(evaluation.pairs.indices),
        "ape_smoothed": evaluation.smoothed,
    }


def outcome_line(row: Row) -> str:
    """One line on a run: which, and how it ended."""
    labels = [f"{row['mode']} on {row['sequence']}", row["variant"], f"seed {row['seed']}"]
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
    "path",
    "associated",
    "ape_smoothed",
)


def _note(run: Run) -> str:
    """A note that a reader of the table has to know of a run that came to its end."""
    smoothed = run.info.get("smoothed") or ""
    return f"the smoothed trajectory is {smoothed}" if smoothed.startswith("not determined") else ""


def _rmse(evaluation: Evaluation, name: str) -> float:
    return float(evaluation.errors[name].stats["rmse"]) if name in evaluation.errors else np.nan


def _row_file(folder: Path, align: Alignment) -> Path:
    return folder / f"row_{align}.json"


def _finished(folder: Path) -> bool:
    try:
        return bool(read_run(folder).info["status"] == "finished")
    except FvslamError:  # none yet, or damaged since: it is done again
        return False


@lru_cache(maxsize=1)  # jobs come sequence by sequence
def _opened(source: Source, rendered: Path | None) -> Sequence:
    sequence = source.open()
    if rendered is None:
        return sequence
    with np.load(rendered) as file:
        images, usable = file["images"], file["usable"]
    return replace(sequence, load=lambda index: images[index] if usable[index] else None)


@cache
def _fingerprint(source: Source) -> list[Any]:
    """The parts of a recording that numbers depend on: what is known of it, and size and time of each file."""
    sequence = source.open()
    truth = sequence.ground_truth
    known = [sequence.stamps, sequence.camera, sequence.ground and sequence.ground.heights, sequence.ground]
    known += [] if truth is None else [truth.stamps, truth.matrices]
    digest = hashlib.blake2b(digest_size=16)
    for fact in known:
        digest.update(fact.tobytes() if isinstance(fact, np.ndarray) else repr(fact).encode())
    path = Path(source.path).expanduser()
    for file in sorted(_files(path)):
        stat = file.stat()
        digest.update(f"{file.relative_to(path)} {stat.st_size} {stat.st_mtime_ns}\n".encode())
    return [source.model_dump(exclude={"name"}), digest.hexdigest()]


def _files(path: Path) -> Iterator[Path]:
    """A file, or all files of a folder but those that we have written into it, which are no part of the recording."""
    if path.is_file():
        yield path
    for folder, inner, names in os.walk(path):
        inner[:] = [name for name in inner if kind_of(Path(folder, name)) is None]
        yield from (file for name in names if (file := Path(folder, name)).is_file())


@cache
def _code() -> list[Any]:
    """The version of everything that computes: libraries by their number, this package by its source."""
    root = Path(fvslam_graph.__file__).parent
    digest = hashlib.blake2b(digest_size=16)
    for file in sorted(root.rglob("*.py")):
        digest.update(file.read_bytes())
    return [digest.hexdigest(), provenance()["versions"]]
