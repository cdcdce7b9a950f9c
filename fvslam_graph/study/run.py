"""A study from its declaration to its report."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
import yaml

from fvslam_graph.core.errors import FvslamError, StudyError
from fvslam_graph.core.files import file_name, write_file, writing
from fvslam_graph.evaluation.plots.runs import plot_runs
from fvslam_graph.runs.ownership import FolderKind, claimed
from fvslam_graph.runs.results import Run
from fvslam_graph.runs.run_folder import read_run
from fvslam_graph.study.common_frames import with_common_frames, with_own_frames
from fvslam_graph.study.execution import execute_all
from fvslam_graph.study.external import external_row
from fvslam_graph.study.figures import FIGURE_SUFFIXES, draw_study
from fvslam_graph.study.jobs import Row, code_version
from fvslam_graph.study.report import write_report
from fvslam_graph.study.results import RESULT_FILES, StudyResults
from fvslam_graph.study.spec import Study
from fvslam_graph.study.statistics import differences
from fvslam_graph.study.systems import run_systems

_log = logging.getLogger(__name__)

DECLARATION, REPORT = "study.yaml", "report.html"
_SEQUENCE_FIGURES = ("trajectory", "error", "drift", "covariance", "nees")  # of each sequence

WatchRows = Callable[[Iterable[tuple[int, Row]], int], Iterable[tuple[int, Row]]]
"""Takes rows as they come and how many there will be; hands them on."""


def run_study(
    study: Study,
    out: Path,
    workers: int | None = None,
    scheduler: str | None = None,
    watch: WatchRows = lambda rows, total: rows,
) -> StudyResults:
    """Run what has not been run yet, then write tables, figures and report.

    Leaves in `out`: runs/ (a run folder each), systems/ (what other programs said), results.csv and .parquet,
    costs.csv, summary.md and .tex, figures/, report.html and study.yaml.

    Args:
        study: What to run.
        out: Folder; that of a study, interrupted or changed, is gone on with.
        workers, scheduler: As for `execute_all`.
        watch: To show the progress.

    Raises:
        ConfigError: A setting is unknown or out of its range.
        StudyError: The scheduler does not answer, or runs fail that have their results in this folder.
        ResultsError: The folder holds something else than a study, is in use, or cannot be written.
    """
    study = study.below(Path.cwd())
    jobs = study.jobs()
    with claimed(out, FolderKind.STUDY):
        others = list(_external(study))
        for row, _ in others:
            if row["status"] != "finished":
                _log.warning("%s on %s: %s", row["mode"], row["sequence"], row["status"])
        done = chain(
            execute_all(jobs, out / "runs", study.align, workers, scheduler), _systems(study, others, len(jobs), out)
        )
        total = len(jobs) + len(study.sequences) * len(study.systems)
        rows: dict[int, Row] = {number: row for number, row in watch(done, total) if number < len(jobs)}
        ordered = [rows[number] for number in range(len(jobs))]
        results = StudyResults.of(_on_common_frames(study, ordered, others, out), study.align)
        _require_no_loss(results, out)
        if _is_written(study, results, out):
            return results
        found = differences(results)
        with writing(out):
            figures = draw_study(results, found, out / "figures")
            trajectories = {
                source.label: _draw_trajectories(results, source.label, [run for _, run in others if run], out)
                for source in study.sequences
            }
            write_report(study, results, found, figures, trajectories, out / REPORT)
        results.write(out)
        with writing(out):
            write_file(out / DECLARATION, _declaration(study) + _of_report(study, results, out))
    return results


def _declaration(study: Study) -> str:
    return yaml.safe_dump(study.model_dump(mode="json"), sort_keys=False)


def _of_report(study: Study, results: StudyResults, out: Path) -> str:
    """A last line of the declaration, by which a report with nothing new in it is not made again."""
    figures = sorted(str(file.relative_to(out)) for file in (out / "figures").rglob("*.*"))
    depends_on = [code_version(), _declaration(study), results.table.to_csv(), figures]
    return f"# report: {hashlib.blake2b(json.dumps(depends_on).encode(), digest_size=16).hexdigest()}\n"


def _is_written(study: Study, results: StudyResults, out: Path) -> bool:
    """Whether all that a study leaves is there, of just these results."""
    there = all((out / name).is_file() for name in (REPORT, DECLARATION, *RESULT_FILES))
    return there and (out / DECLARATION).read_text().endswith(_of_report(study, results, out))


def _on_common_frames(
    study: Study, rows: Sequence[Row], others: Sequence[tuple[Row, Run | None]], out: Path
) -> list[Row]:
    """All rows, sequence by sequence also compared on the frames that all methods have a pose for."""
    every = [*((row, None) for row in rows), *others]
    found = {id(row): row for row, _ in every}
    for source in study.sequences:
        here = [
            (row, run) for row, run in every if row["sequence"] == source.label and np.isfinite(row.get("ape", np.nan))
        ]
        known = [row for row, _ in here]
        if len({(row["coverage"], row["associated"]) for row in known}) > 1:
            sequence = source.open()
            assert sequence.ground_truth is not None, "there are errors"
            online = (run.online if run else read_run(out / "runs" / row["folder"]).online for row, run in here)
            changed = with_common_frames(known, online, sequence.stamps, sequence.ground_truth, study.align)
        else:
            changed = [with_own_frames(row) for row in known]
        found |= {id(row): new for row, new in zip(known, changed, strict=True)}
    return list(found.values())


def _require_no_loss(results: StudyResults, out: Path) -> None:
    """Refuse to write over the results of runs that have come to their end, and fail now."""
    lost = results.lost(out)
    if len(lost):
        first = lost.iloc[0]
        raise StudyError(
            f"{len(lost)} of {len(results.table)} runs fail that had come to their end ({first['mode']} on "
            f"{first['sequence']}: {first['status']}); the results in {out} are left as they were, choose another "
            "folder for the new ones"
        )


def _external(study: Study) -> Iterator[tuple[Row, Run | None]]:
    """Other people's trajectories, with the rows that say how good they are."""
    for source in study.sequences:
        files = study.external.get(source.label, {})
        if not files:
            continue
        try:
            sequence = source.open()
        except FvslamError:  # its runs are rows that say so
            continue
        for name, file in files.items():
            yield external_row(name, file, sequence, study.align)


def _systems(study: Study, others: list[tuple[Row, Run | None]], first: int, out: Path) -> Iterator[tuple[int, Row]]:
    """Run the other programs; their rows, numbered from `first`, and trajectories are added to the others'."""
    found = run_systems(study.sequences, study.systems, study.system_limit, study.align, out / "systems")
    for number, other in enumerate(found, first):
        others.append(other)
        yield number, other[0]


def _draw_trajectories(results: StudyResults, sequence: str, others: list[Run], out: Path) -> list[Path]:
    """Draw of each mode the run whose error is the median, with the first preset and variant, and other people's."""
    here = results.finished[(results.finished["sequence"] == sequence) & (results.finished["folder"] != "")]
    runs = []
    for mode, group in here.groupby("mode", sort=False):
        first = group.iloc[0]
        alike = group[(group["preset"] == first["preset"]) & (group["variant"] == first["variant"])]
        median = alike.sort_values("ape").iloc[(len(alike) - 1) // 2]
        runs.append(replace(read_run(out / "runs" / median["folder"]), name=str(mode)))
    runs += [run for run in others if run.info["sequence"] == sequence]
    if not runs:
        return []
    folder = out / "figures" / file_name(sequence)
    return plot_runs(runs, folder, results.align, _SEQUENCE_FIGURES, FIGURE_SUFFIXES)
