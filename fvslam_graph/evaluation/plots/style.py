"""The look of all figures: sizes, colours, line styles, names, legends, and how they are written."""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fvslam_graph.core.files import one_line, write_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMN_WIDTH, PAGE_WIDTH = 3.5, 7.16  # inches: of a column and of a page, as IEEE prints them
# Okabe and Ito's palette, which colour-blind readers can tell apart.
RUN_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#888888", "#C0B000")
_DASHES = ((), (7, 2), (1.2, 1.2), (7, 2, 1.5, 2), (12, 3), (4, 1.5, 1.2, 1.5, 1.2, 1.5), (2.5, 1.5), (10, 2, 3, 2))
_MARKERS = ("o", "s", "^", "D", "v", "P", "<", "*", "X", ">", "h")
_HATCHES = ("", "////", "ooo", "xxxx", r"\\\\", "----", "++++", "||||")
TRUTH = {"color": "black", "linestyle": (0, (4, 2)), "linewidth": 0.9, "label": "ground truth", "zorder": 3}
STYLE = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "figure.titlesize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "lines.linewidth": 1.1,
    "lines.markersize": 4,
    "hatch.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "savefig.dpi": 300,
    "pdf.fonttype": 42,  # text stays text in the PDF
    "svg.fonttype": "none",  # and in the SVG
    "svg.hashsalt": "fvslam",
    "text.parse_math": False,  # a dollar in a name is a dollar
}
MAX_NAME_IN_FIGURE = 40  # characters of a name in a figure
_CHARACTERS_PER_INCH = 14  # of STYLE's font, on average
_LEGEND_COLUMNS = 4  # at most
_HANDLE_WIDTH = 0.6  # inches beside a name in a legend


@dataclass(frozen=True)
class Look:
    """How one run is drawn, in colour, in grey and for colour-blind readers: no two looks share line and marker.

    Attributes:
        number: Of the run, from 0.
    """

    number: int

    @property
    def colour(self) -> str:
        """A colour; after eight, they begin again."""
        return RUN_COLOURS[self.number % len(RUN_COLOURS)]

    @property
    def point(self) -> dict[str, Any]:
        """Arguments of `Axes.plot` for points; every other shape is hollow."""
        return {
            "linestyle": "none",
            "color": self.colour,
            "marker": _MARKERS[self.number % len(_MARKERS)],
            "markerfacecolor": "white" if self.number % 2 else self.colour,
            "markeredgewidth": 0.8,
        }

    @property
    def line(self) -> dict[str, Any]:
        """Arguments of `Axes.plot` for a curve: its markers are few, and not where those of others are."""
        dashes = _DASHES[self.number % len(_DASHES)]
        return self.point | {
            "linestyle": (0, dashes) if dashes else "-",
            "markevery": (0.03 * (self.number + 1) % 0.25, 0.25),
        }

    @property
    def area(self) -> dict[str, Any]:
        """Properties of a filled patch."""
        return {"facecolor": self.colour, "hatch": _HATCHES[self.number % len(_HATCHES)], "edgecolor": "black"}


def legible(name: str) -> str:
    """A name as it is written in figures; matplotlib leaves what begins with an underscore out of legends."""
    name = one_line(name)
    short = name if len(name) <= MAX_NAME_IN_FIGURE else f"{name[: MAX_NAME_IN_FIGURE - 1]}…"
    return f" {short}" if short.startswith("_") else short


def wrapped(text: str, inches: float) -> str:
    """The text in lines that are no wider than so many inches."""
    return textwrap.fill(text, int(inches * _CHARACTERS_PER_INCH))


def legend_below(figure: Figure, axes: Axes) -> None:
    """Put the legend of axes below the figure, which grows by it, in as many columns as its width holds."""
    handles, labels = axes.get_legend_handles_labels()
    labels = [wrapped(label, figure.get_figwidth() - _HANDLE_WIDTH) for label in labels]
    for columns in range(min(len(labels), _LEGEND_COLUMNS), 0, -1):
        legend = figure.legend(handles, labels, loc="outside lower center", ncols=columns)
        box = legend.get_window_extent()
        if columns == 1 or box.width <= figure.bbox.width:
            figure.set_figheight(figure.get_figheight() + box.height / figure.dpi)
            return
        legend.remove()


def save(figure: Figure, stem: Path, suffixes: Sequence[str]) -> list[Path]:
    """Write a figure once for each suffix, always with the same bytes; returns the files."""
    files = []
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # of a name in letters that the font has not: boxes
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # laid out once, and not for every format
        for suffix in suffixes:
            files.append(stem.with_name(stem.name + suffix))
            undated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(suffix)
            content = io.BytesIO()
            figure.savefig(content, format=suffix[1:], metadata=undated)
            write_file(files[-1], content.getvalue())
    return files
