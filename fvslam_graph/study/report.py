"""A study as one HTML file that needs nothing else: tables that sort, figures, settings, versions, machine."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

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
}
_ALL_COLUMNS = ("status", "ape", "ape_rot", "rpe", "rpe_1m", "t_rel", "r_rel", "scale", "nees", "coverage", "tracked")


@dataclass(frozen=True)
class Picture:
    """A figure within the file."""

    source: str
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
        summary=results.summary(),
        figures=_pictures(figures),
        differences=differences_table(found, results.circumstances),
        verdicts=verdicts(found),
        trajectories={sequence: _pictures(files) for sequence, files in trajectories.items()},
        failures=results.failures(),
        all=_all_runs(results),
        declaration=yaml.safe_dump(study.model_dump(mode="json", exclude_defaults=True), sort_keys=False),
        circumstances=yaml.safe_dump(provenance(), sort_keys=False),
    )
    write_file(file, html)


def _pictures(files: Sequence[Path]) -> list[Picture]:
    return [
        Picture(f"data:image/svg+xml;base64,{base64.b64encode(file.read_bytes()).decode()}", CAPTIONS[file.stem])
        for file in files
        if file.suffix == ".svg"
    ]


def _all_runs(results: StudyResults) -> Table:
    columns = [*LABELS, "seed", *_ALL_COLUMNS, *COSTS]
    cells = results.table[columns].map(lambda value: f"{value:.5g}" if isinstance(value, float) else str(value))
    return Table(columns, cells.replace({"nan": "-", "<NA>": "-"}).to_numpy().tolist(), len(LABELS))
