"""One table of many runs, and one of everything about a single trajectory."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.files import one_line
from fvslam_graph.core.text_files import read_text
from fvslam_graph.core.trajectory import Status
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.runs.results import Run
from fvslam_graph.runs.run_folder import METRICS_FILE, read_run

if TYPE_CHECKING:
    from rich.table import Table as RichTable

    from fvslam_graph.evaluation.metrics import Evaluation

RUNS_CAPTION = (
    "Online trajectories, but for the APE of the smoothed one. APE and RPE: RMSE, RPE from frame to frame; Sim(3): in "
    "the scale of the reference, whatever `align`. t_rel and r_rel: 100-800 m, no scale correction. ms/frame: median "
    "without reading images. NEES is not judged where the noise of the reference alone would double it, or where its "
    "axes are not the camera's."
)
UNJUDGED = "not judged"  # in place of a NEES, where the reference is not good enough
TEXT_COLUMNS = 4  # the first columns are text, the others numbers
RUN_COLUMNS = (
    *("run", "mode", "scale", "status"),
    *("align", "APE (m)", "Sim(3) APE (m)", "smoothed (m)", "RPE (m)", "t_rel (%)", "r_rel (deg/100 m)"),
    *("NEES (95 % band)", "coverage", "tracked", "ms/frame", "peak MB"),
)


def runs_table(folders: Sequence[Path]) -> Table:
    """The runs, one row each; "-" where a run failed early, has no ground truth or was not evaluated.

    Raises:
        ResultsError: A folder is not that of a run, or damaged.
    """
    return Table(RUN_COLUMNS, [_row(folder, read_run(folder)) for folder in folders], TEXT_COLUMNS, RUNS_CAPTION)


def summary_table(evaluation: Evaluation) -> RichTable:
    """All metrics of one trajectory as a table for the terminal, with the notes below."""
    from rich.table import Table as RichTable
    from rich.text import Text

    facts = facts_table(evaluation)
    table = RichTable(title=Text(one_line(evaluation.name)), caption=Text(facts.caption), show_header=False)
    for row in facts.rows:
        table.add_row(*row)
    return table


def facts_table(evaluation: Evaluation) -> Table:
    """All metrics of one trajectory, a row each, with the notes below."""
    pairs, rows = evaluation.pairs, []
    how = "with the reference interpolated" if pairs.interpolated else "by nearest stamps"
    if evaluation.coverage is not None:
        rows.append(["coverage", f"{100 * evaluation.coverage:.1f} % of {evaluation.frames} frames"])
    rows.append(["association", f"{len(pairs.indices)} of {evaluation.poses} poses {how}"])
    scale = "unknown" if np.isnan(evaluation.scale) else f"{evaluation.scale:.4f}"
    rows.append(["alignment", f"{evaluation.alignment} (scale to the reference {scale})"])
    if evaluation.alignment != "sim3" and not np.isnan(evaluation.ape_scaled):
        rows.append(["Sim(3)", f"ape_trans RMSE {evaluation.ape_scaled:.4g} m, in the scale of the reference"])
    for name, result in evaluation.errors.items():
        unit = "deg" if name.endswith("rot") else "m"
        stats = {key: f"{result.stats[key]:.4g}" for key in ("rmse", "median", "max")}
        rows.append([name, f"RMSE {stats['rmse']} {unit}, median {stats['median']}, max {stats['max']}"])
    if not np.isnan(evaluation.smoothed):
        rows.append(["smoothed", f"ape_trans RMSE {evaluation.smoothed:.4g} m, the trajectory by all data"])
    if evaluation.drift.segments:
        scaled = f"{evaluation.drift_scaled.t_rel:.2f} % after scaling"
        rows.append(["t_rel", f"{evaluation.drift.t_rel:.2f} % ({scaled})"])
        rows.append(["r_rel", f"{evaluation.drift.r_rel:.3f} deg/100 m, {evaluation.drift.segments} segments"])
    for part, nees in evaluation.nees.items():
        said = f"{nees.mean:.2f}" if nees.judged else "not judged by this reference"
        rows.append([f"NEES, {part}", f"{said} (95 % band {nees.low:.2f}-{nees.high:.2f}, {nees.count} motions)"])
    return Table(("metric", one_line(evaluation.name)), rows, 2, "\n".join(evaluation.notes))


def scale_sentence(evaluations: Mapping[str, Evaluation], method: str, parts: Sequence[str]) -> str:
    """Why a method may be worse than its parts in metres: whether its shape is, too; "" where it is not worse."""
    ape = {name: found.errors["ape_trans"].stats["rmse"] for name, found in evaluations.items()}
    shape = {name: found.ape_scaled for name, found in evaluations.items()}
    worse = [name for name in parts if ape[method] > ape[name]]
    if not worse:
        return ""
    why = f"{method} errs more than {' and '.join(worse)} in metres ({evaluations[method].alignment} APE)"
    if all(shape[method] <= shape[name] for name in parts):
        return (
            f"{why}, and less than {' and '.join(parts)} in shape (Sim(3) APE): its path keeps the scale in which it "
            "began, where they take up each new measurement of it."
        )
    return f"{why}; in shape (Sim(3) APE) it is {shape[method]:.3f} m."


def _row(folder: Path, run: Run) -> list[str]:
    path = folder / METRICS_FILE
    try:
        cells = _metric_cells(json.loads(read_text(path, ResultsError)) if path.exists() else {})
    except (OSError, ValueError, TypeError, AttributeError, KeyError, RecursionError) as error:
        raise ResultsError(f"{path} cannot be read, evaluate the run again: {error}") from None
    if (run.info.get("smoothed") or "").startswith("not determined"):
        cells[RUN_COLUMNS.index("smoothed (m)") - TEXT_COLUMNS] = "not determined"
    seen = np.isin(run.frames.get("status", ()), (Status.TRACKED, Status.STATIC)).mean() if len(run.online) else np.nan
    times = [column for name, column in run.frames.items() if name.endswith("_ms") and name != "read_ms"]
    peak = run.info.get("totals", {}).get("peak_memory_mb")
    return [
        run.name,
        *(run.info.get(key) or "-" for key in ("mode", "scale_source", "status")),
        *cells,
        _cell(100 * run.coverage, ".1f", " %"),
        _cell(100 * run.coverage * seen, ".1f", " %"),
        _cell(float(np.median(np.sum(times, axis=0))) if times else None, ".1f"),
        _cell(peak if isinstance(peak, float | int) else None, ".0f"),
    ]


def _metric_cells(metrics: dict[str, Any]) -> list[str]:
    """The columns from `align` to NEES."""
    nees = metrics.get("nees", {}).get("pose")
    return [
        metrics.get("alignment", "-"),
        _cell(_pick(metrics, "ape_trans", "rmse"), ".3f"),
        _cell(metrics.get("ape_scaled"), ".3f"),
        _cell(metrics.get("ape_smoothed"), ".3f"),
        _cell(_pick(metrics, "rpe_trans", "rmse"), ".4f"),
        _cell(_pick(metrics, "drift", "t_rel"), ".2f"),
        _cell(_pick(metrics, "drift", "r_rel"), ".3f"),
        "-"
        if nees is None
        else f"{nees['mean']:.2f} ({nees['low']:.2f}-{nees['high']:.2f})"
        if nees["judged"]
        else UNJUDGED,
    ]


def _pick(data: dict[str, Any], group: str, key: str) -> float | None:
    value: float | None = data.get(group, {}).get(key)
    return value


def _cell(value: float | None, style: str, unit: str = "") -> str:
    return "-" if value is None or np.isnan(value) else f"{value:{style}}{unit}"
