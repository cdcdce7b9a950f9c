"""Figures of a study: accuracy by mode, accuracy against cost, and the differences between modes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fvslam_graph.evaluation.plots.style import (
    COLUMN_WIDTH,
    PAGE_WIDTH,
    RUN_COLOURS,
    STYLE,
    Look,
    legend_below,
    legible,
    save,
    wrapped,
)
from fvslam_graph.runs.ownership import claim_files
from fvslam_graph.study.results import EXTERNAL, StudyResults
from fvslam_graph.study.statistics import COMPARED, Difference

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURE_SUFFIXES = (".png", ".pdf", ".svg")
PANEL_COLUMNS = 3  # panels beside each other
_LABEL_WIDTH, _ROW_HEIGHT, _LINE_HEIGHT = 1.5, 0.17, 0.13  # inches
_PANEL_WIDTH = 1.7  # inches, for a panel's title


def draw_study(results: StudyResults, found: Sequence[Difference], out: Path) -> list[Path]:
    """Write accuracy, cost and differences as PNG, PDF and SVG; what there is nothing to draw of is left out.

    Returns:
        The files.
    """
    import matplotlib

    drawings: dict[str, Callable[[], Figure]] = {}
    if results.finished["ape"].notna().any():
        drawings["accuracy"] = lambda: _accuracy(results)
        drawings["cost"] = lambda: _cost(results)
    if any(difference.metric == "ape" for difference in found):
        drawings["differences"] = lambda: _differences(found)
    claim_files(out, [f"{name}{suffix}" for name in drawings for suffix in FIGURE_SUFFIXES])
    files = []
    with matplotlib.rc_context(STYLE):
        for name, draw in drawings.items():
            files += save(draw(), out / name, FIGURE_SUFFIXES)
    return files


def _looks(results: StudyResults) -> dict[str, Look]:
    """One for each mode."""
    return {mode: Look(number) for number, mode in enumerate(results.table["mode"].unique())}


def _panels(titles: Sequence[str], height: float, sharey: bool) -> tuple[Figure, list[Axes]]:
    """A figure with a panel of this height (inches) for each title; panels in a row share their rows."""
    from matplotlib.figure import Figure

    columns = min(PANEL_COLUMNS, len(titles))
    rows = -(-len(titles) // columns)
    lines = [wrapped(legible(title), _PANEL_WIDTH) for title in titles]
    height += _LINE_HEIGHT * max(line.count("\n") for line in lines)
    width = COLUMN_WIDTH if columns == 1 else PAGE_WIDTH
    figure = Figure(figsize=(width, height * rows + 0.5), layout="constrained")
    panels = list(figure.subplots(rows, columns, squeeze=False, sharey=sharey).ravel())
    for spare in panels[len(titles) :]:
        spare.remove()
    for axes, title in zip(panels, lines, strict=False):
        axes.set_title(title)
    return figure, panels[: len(titles)]


def _name_rows(axes: Axes, names: Sequence[str]) -> None:
    axes.set_yticks(range(len(names)), [wrapped(name, _LABEL_WIDTH) for name in names])
    axes.set_ylim(len(names) - 0.5, -0.5)


def _height(names: Sequence[str]) -> float:
    """Inches of a panel whose rows have these names."""
    lines = max(wrapped(name, _LABEL_WIDTH).count("\n") for name in names)
    return 0.7 + (_ROW_HEIGHT + _LINE_HEIGHT * lines) * len(names)


def _accuracy(results: StudyResults) -> Figure:
    looks = _looks(results)
    known = results.finished[results.finished["ape"].notna()]
    own = results.table[results.table["preset"] != EXTERNAL]
    labels = [label for label in ("mode", "preset", "variant") if label == "mode" or own[label].nunique() > 1]
    methods = list(known[labels].drop_duplicates().itertuples(index=False, name=None))
    names = [", ".join(legible(part) for part in method if part) for method in methods]
    sequences = known["sequence"].unique()
    figure, panels = _panels(sequences, _height(names), sharey=True)
    for axes, sequence in zip(panels, sequences, strict=True):
        runs = known[known["sequence"] == sequence]
        for method, group in runs.groupby(labels, sort=False):
            row, look = methods.index(method), looks[method[0]]
            axes.plot(group["ape"], [row] * len(group), **look.point)
            axes.plot(group["ape"].median(), row, "|", color="black", markersize=10, markeredgewidth=1.2)
        axes.set(xlabel="APE (m)", xlim=(0, 1.05 * runs["ape"].max() or 1))
        _name_rows(axes, names)
    facts = f"online trajectories, {results.align} alignment; a dot a seed, a bar for the median"
    figure.suptitle(wrapped(facts, figure.get_figwidth()))
    return figure


def _cost(results: StudyResults) -> Figure:
    looks = _looks(results)
    known = results.finished[results.finished["ape"].notna() & results.finished["ms"].notna()]
    sequences = known["sequence"].unique()
    figure, panels = _panels(sequences, 1.9, sharey=False)
    for axes, sequence in zip(panels, sequences, strict=True):
        runs = known[known["sequence"] == sequence]
        for mode, look in looks.items():
            group = runs[runs["mode"] == mode]
            if mode in known["mode"].values:
                axes.plot(group["ms"], group["ape"], **look.point, label=legible(mode))
        axes.set(xlabel="time per frame (ms)", ylabel="APE (m)")
        axes.set_ylim(bottom=0)
        axes.set_xlim(left=0)
    legend_below(figure, panels[0])
    return figure


def _differences(found: Sequence[Difference]) -> Figure:
    shown = [difference for difference in found if difference.metric == "ape"]
    sequences = list(dict.fromkeys(difference.sequence for difference in shown))
    pairs = list(dict.fromkeys((difference.a, difference.b) for difference in shown))
    names = [f"{legible(a)} / {legible(b)}" for a, b in pairs]
    figure, panels = _panels(sequences, _height(names), sharey=True)
    for axes, sequence in zip(panels, sequences, strict=True):
        for difference in shown:
            if difference.sequence == sequence:
                row = pairs.index((difference.a, difference.b))
                sure = difference.significant
                colour = RUN_COLOURS[0] if sure else "grey"
                if np.isfinite(difference.low):
                    axes.plot([difference.low, difference.high], [row, row], color=colour, linewidth=1.5)
                axes.plot(difference.ratio, row, "o", color=colour, markerfacecolor=colour if sure else "white")
        axes.axvline(1, color="black", linewidth=0.8)
        axes.set(xlabel=f"ratio of {COMPARED['ape']}")
        _name_rows(axes, names)
    figure.suptitle(wrapped("below 1: the first is better; hollow and grey: not significant", figure.get_figwidth()))
    return figure
