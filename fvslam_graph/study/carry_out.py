"""A study from its declaration to its report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import yaml

from fvslam_graph.errors import FvslamError
from fvslam_graph.evaluation.plots import plot_runs
from fvslam_graph.files import writing
from fvslam_graph.results import Run
from fvslam_graph.run_folder import read_run
from fvslam_graph.study.declaration import Study
from fvslam_graph.study.execution import execute_all
from fvslam_graph.study.external import external_row
from fvslam_graph.study.figures import SUFFIXES, draw_study
from fvslam_graph.study.job import Row, words
from fvslam_graph.study.outcome import Outcome
from fvslam_graph.study.report import write_report
from fvslam_graph.study.statistics import differences

Watch = Callable[[Iterable[tuple[int, Row]], int], Iterable[tuple[int, Row]]]
"""Takes rows as they come and how many there will be; hands them on."""


def carry_out(
    study: Study,
    out: Path,
    workers: int | None = None,
    scheduler: str | None = None,
    watch: Watch = lambda rows, total: rows,
) -> Outcome:
    """Run what has not been run yet, then write tables, figures and report.

    Leaves in `out`: runs/ (a run folder each), results.csv and .parquet, costs.csv, summary.md and .tex, figures/,
    report.html and study.yaml.

    Args:
        study: What to run.
        out: Folder; that of the same study, interrupted or changed, is gone on with.
        workers, scheduler: As for `execute_all`.
        watch: To show the progress.

    Raises:
        ConfigError: A setting is unknown or out of its range.
        StudyError: The scheduler does not answer.
        ResultsError: The folder cannot be written.
    """
    jobs = study.jobs()
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        (out / "study.yaml").write_text(yaml.safe_dump(study.model_dump(mode="json"), sort_keys=False))
    rows: dict[int, Row] = dict(watch(execute_all(jobs, out / "runs", study.align, workers, scheduler), len(jobs)))
    others = list(_external(study))
    outcome = Outcome.of([*(rows[number] for number in range(len(jobs))), *(row for row, _ in others)], study.align)
    outcome.write(out)
    found = differences(outcome)
    with writing(out):
        figures = draw_study(outcome, found, out / "figures")
        trajectories = {
            source.label: _draw_trajectories(outcome, source.label, [run for _, run in others if run], out)
            for source in study.sequences
        }
        write_report(study, outcome, found, figures, trajectories, out / "report.html")
    return outcome


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


def _draw_trajectories(outcome: Outcome, sequence: str, others: list[Run], out: Path) -> list[Path]:
    """Of each mode the run whose error is the median, with the first preset and variant, and other people's."""
    here = outcome.finished[(outcome.finished["sequence"] == sequence) & (outcome.finished["folder"] != "")]
    runs = []
    for mode, group in here.groupby("mode", sort=False):
        first = group.iloc[0]
        alike = group[(group["preset"] == first["preset"]) & (group["variant"] == first["variant"])]
        median = alike.sort_values("ape").iloc[(len(alike) - 1) // 2]
        runs.append(replace(read_run(out / "runs" / median["folder"]), name=str(mode)))
    runs += [run for run in others if run.info["sequence"] == sequence]
    if not runs:
        return []
    folder = out / "figures" / words(sequence)
    return plot_runs(runs, folder, outcome.align, ("trajectory", "error"), SUFFIXES)
