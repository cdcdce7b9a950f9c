"""A study as one HTML file that needs nothing else: figures, tables that sort and filter, settings, versions."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from markupsafe import Markup

from fvslam_graph.core.files import write_file
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.runs.provenance import provenance
from fvslam_graph.study.results import COSTS, LABELS, StudyResults
from fvslam_graph.study.spec import Study
from fvslam_graph.study.statistics import Difference, differences_table, verdicts

CAPTIONS = {
    "accuracy": "Absolute pose error by mode.",
    "cost": "What accuracy costs: time per frame without reading images, each run a dot.",
    "differences": "Ratios of the errors of two modes, with 95 % bootstrap intervals.",
    "plot_trajectory": "Trajectories: of each mode the run whose error is the median.",
    "plot_error": "Their errors along the path.",
    "plot_drift": "Their relative errors: quartiles, and whiskers from 5 to 95 %.",
    "plot_covariance": "Their errors since the start, within three of the standard deviations that they claim.",
    "plot_nees": "NEES of their poses: in the band, the claimed covariance fits the error.",
}
_ALL_COLUMNS = ("status", "ape", "ape_rot", "rpe", "rpe_1m", "t_rel", "r_rel", "scale", "nees", "coverage", "tracked")
_LOWER_IS_BETTER = re.compile("APE|RPE|smoothed|t_rel|r_rel")


@dataclass(frozen=True)
class Picture:
    """A figure within the file.

    Attributes:
        name: Of its file.
        svg: The drawing; its text can be selected.
        caption: Below it.
    """

    name: str
    svg: Markup
    caption: str


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Attributes:
        value: What it says.
        spread: The range, smaller.
        best: Whether no other method on this sequence is better.
    """

    value: str
    spread: str = ""
    best: bool = False


@dataclass(frozen=True)
class GroupedTable:
    """A table whose rows stand below the sequence that they are of.

    Attributes:
        columns: The first one says which method.
        groups: Name of each sequence, and its rows.
        caption: Below the table.
    """

    columns: Sequence[str]
    groups: Sequence[tuple[str, Sequence[Sequence[Cell]]]]
    caption: str


def write_report(
    study: Study,
    results: StudyResults,
    found: Sequence[Difference],
    figures: Sequence[Path],
    trajectories: Mapping[str, Sequence[Path]],
    file: Path,
) -> None:
    """Write the HTML file.

    Args:
        study: What was declared.
        results: All runs.
        found: Differences between modes.
        figures: Of the study; those in SVG are shown.
        trajectories: Likewise, by sequence.
        file: Where to.
    """
    from jinja2 import Environment, PackageLoader

    template = Environment(loader=PackageLoader("fvslam_graph.study", "."), autoescape=True, trim_blocks=True)
    finished, count = len(results.finished), len(results.table)
    html = template.get_template("report.html.j2").render(
        title=study.name,
        runs=f"{finished} of {count} runs came to their end.",
        summary=grouped(results.summary()),
        figures=_pictures(figures, "study"),
        differences=grouped(differences_table(found, results.circumstances)),
        verdicts=verdicts(found),
        trajectories={
            sequence: _pictures(files, f"sequence{number}")
            for number, (sequence, files) in enumerate(trajectories.items())
        },
        failures=grouped(results.failures()),
        all=grouped(_all_runs(results)),
        declaration=yaml.safe_dump(study.model_dump(mode="json", exclude_defaults=True), sort_keys=False),
        circumstances=yaml.safe_dump(provenance(), sort_keys=False),
    )
    write_file(file, html)


def grouped(table: Table) -> GroupedTable:
    """Rows by their sequence; of several columns that say which method a row is, one; of numbers, the best marked.

    Columns of numbers that no row has are left out.
    """
    of_sequence = table.columns.index("sequence") if "sequence" in table.columns else None
    keys = [column for column in range(table.keys) if column != of_sequence]
    several = [column for column in keys if len({row[column] for row in table.rows}) > 1] or keys[:1]
    words = [column for column in range(table.keys, table.words) if column != of_sequence]
    filled = [{row[column] for row in table.rows} - {"-"} for column in range(len(table.columns))]
    numbers = [column for column in range(table.words, len(table.columns)) if filled[column]]
    sequences = [row[of_sequence] if of_sequence is not None else "" for row in table.rows]
    groups = []
    for sequence in dict.fromkeys(sequences):
        rows = [row for row, name in zip(table.rows, sequences, strict=True) if name == sequence]
        best = {column: _best(table.columns[column], [row[column] for row in rows]) for column in numbers}
        cells = [
            [
                Cell(", ".join(row[column] for column in several if row[column])),
                *(_cell(row[column], best[column]) for column in numbers),
                *(Cell(row[column]) for column in words),
            ]
            for row in rows
        ]
        groups.append((sequence, cells))
    columns = (" ".join(table.columns[column] for column in several), *(table.columns[c] for c in (*numbers, *words)))
    return GroupedTable(columns, groups, table.caption)


def _best(column: str, cells: Sequence[str]) -> float:
    """The smallest of several errors; NaN where there is nothing to compare, or smaller is not better."""
    values = [value for value in map(_value, cells) if not math.isnan(value)]
    return min(values) if len(values) > 1 and _LOWER_IS_BETTER.search(column) else math.nan


def _cell(text: str, best: float) -> Cell:
    value, _, spread = text.partition(" ")
    number = _value(text)
    return Cell(value, spread, number == best) if not math.isnan(number) else Cell(text)


def _value(text: str) -> float:
    """The number that a cell begins with; NaN where it does not."""
    try:
        return float(text.split(" ")[0])
    except ValueError:
        return math.nan


def _pictures(files: Sequence[Path], prefix: str) -> list[Picture]:
    return [
        Picture(file.stem, _inline(file.read_text(encoding="utf-8"), f"{prefix}-{file.stem}"), CAPTIONS[file.stem])
        for file in files
        if file.suffix == ".svg"
    ]


def _inline(svg: str, prefix: str) -> Markup:
    """A drawing as an element of a page, where no other has its ids."""
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    return Markup(re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{prefix}-", svg))


def _all_runs(results: StudyResults) -> Table:
    columns = [*LABELS, "seed", *_ALL_COLUMNS, *COSTS]
    table = results.table.assign(status=results.table["status"].str.partition(":")[0])
    cells = table[columns].map(lambda value: f"{value:.4g}" if isinstance(value, float) else str(value))
    return Table(columns, cells.replace({"nan": "-", "<NA>": "-"}).to_numpy().tolist(), len(LABELS), keys=len(LABELS))
