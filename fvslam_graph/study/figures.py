"""Figures of a study: accuracy by mode, accuracy against cost, and the differences between modes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fvslam_graph.evaluation.plots import RUN_COLOURS, STYLE, legible, save
from fvslam_graph.runs.ownership import claim_files
from fvslam_graph.study.results import EXTERNAL, StudyResults
from fvslam_graph.study.statistics import COMPARED, Difference

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURE_SUFFIXES = (".png", ".pdf", ".svg")
PANEL_COLUMNS = 3  # panels beside each other


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


def colours(results: StudyResults) -> dict[str, str]:
    """One for each mode."""
    modes = results.table["mode"].unique()
    return {mode: RUN_COLOURS[number % len(RUN_COLOURS)] for number, mode in enumerate(modes)}


def _panels(results: StudyResults, height: float) -> tuple[Figure, Iterator[tuple[Axes, str, pd.DataFrame]]]:
    """A figure with a panel for each sequence that has ground truth, and its runs."""
    from matplotlib.figure import Figure

    known = results.finished[results.finished["ape"].notna()]
    sequences = known["sequence"].unique()
    columns = min(PANEL_COLUMNS, len(sequences))
    rows = -(-len(sequences) // columns)
    figure = Figure(figsize=(max(6.5, 3.2 * columns + 1), height * rows + 0.5), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for spare in panels[len(sequences) :]:
        spare.remove()
    return figure, (
        (axes, sequence, known[known["sequence"] == sequence])
        for axes, sequence in zip(panels, sequences, strict=False)
    )


def _accuracy(results: StudyResults) -> Figure:
    by_mode = colours(results)
    own = results.table[results.table["preset"] != EXTERNAL]
    names = [label for label in ("mode", "preset", "variant") if label == "mode" or own[label].nunique() > 1]
    longest = results.table.groupby("sequence")[names].apply(lambda rows: len(rows.drop_duplicates())).max()
    figure, panels = _panels(results, 1 + 0.25 * longest)
    for axes, sequence, runs in panels:
        labels = []
        for row, (label, group) in enumerate(runs.groupby(names, sort=False)):
            labels.append(", ".join(legible(part) for part in label if part))
            colour = by_mode[label[0]]
            axes.plot(group["ape"], [row] * len(group), ".", color=colour, alpha=0.5)
            axes.plot(group["ape"].median(), row, "|", color=colour, markersize=14, markeredgewidth=2)
        axes.set(title=legible(sequence), xlabel="APE (m)", yticks=range(len(labels)), yticklabels=labels)
        axes.set(xlim=(0, 1.05 * runs["ape"].max()), ylim=(len(labels) - 0.5, -0.5))
    figure.suptitle(
        f"online trajectories, {results.align} alignment; one dot a seed, a bar for the median", fontsize=10
    )
    return figure


def _cost(results: StudyResults) -> Figure:
    by_mode = colours(results)
    figure, panels = _panels(results, 2.8)
    for axes, sequence, runs in panels:
        for mode, group in runs.groupby("mode", sort=False):
            name, colour = legible(str(mode)), by_mode[str(mode)]
            axes.plot(group["ms"], group["ape"], "o", color=colour, alpha=0.6, markersize=5, label=name)
        axes.set(title=legible(sequence), xlabel="time per frame (ms)", ylabel="APE (m)")
        axes.set_ylim(bottom=0)
        axes.set_xlim(left=0)
        handles, names = axes.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=5)
    return figure


def _differences(found: Sequence[Difference]) -> Figure:
    from matplotlib.figure import Figure

    shown = [difference for difference in found if difference.metric == "ape"]
    sequences = list(dict.fromkeys(difference.sequence for difference in shown))
    pairs = list(dict.fromkeys((difference.a, difference.b) for difference in shown))
    columns = min(PANEL_COLUMNS, len(sequences))
    rows = -(-len(sequences) // columns)
    figure = Figure(figsize=(max(6.5, 3.2 * columns + 1), (1 + 0.25 * len(pairs)) * rows + 0.5), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    for spare in panels[len(sequences) :]:
        spare.remove()
    for axes, sequence in zip(panels, sequences, strict=False):
        for difference in shown:
            if difference.sequence == sequence:
                row = pairs.index((difference.a, difference.b))
                colour = RUN_COLOURS[0] if difference.significant else "grey"
                if np.isfinite(difference.low):
                    axes.plot([difference.low, difference.high], [row, row], color=colour, linewidth=2)
                axes.plot(difference.ratio, row, "o", color=colour, markersize=5)
        axes.axvline(1, color="black", linewidth=0.8)
        axes.set(title=legible(sequence), xlabel=f"ratio of {COMPARED['ape']}")
        axes.set(yticks=range(len(pairs)), yticklabels=[f"{legible(a)} / {legible(b)}" for a, b in pairs])
    panels[0].set_ylim(len(pairs) - 0.5, -0.5)
    figure.suptitle("below 1: the first is better; grey: not significant", fontsize=10)
    return figure
