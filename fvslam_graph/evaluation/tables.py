"""A table of text, for a terminal, Markdown and LaTeX."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

from fvslam_graph.core.files import one_line

if TYPE_CHECKING:
    from rich.table import Table as RichTable

_LATEX = {
    "\\": r"\textbackslash{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
    **{character: f"{{{character}}}" for character in "[]*"},  # which the end of the row before would take as its own
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
}


@dataclass(frozen=True)
class Table:
    """Cells as they are printed.

    Attributes:
        columns: Their names.
        rows: The cells of each row.
        words: How many columns, from the left, are words; the others are numbers.
        caption: Below the table.
        keys: How many columns, from the left, say which row it is.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1
    caption: str = ""
    keys: int = 1

    def markdown(self) -> str:
        """The Markdown table with the caption below."""
        rule = ["---"] * self.words + ["---:"] * (len(self.columns) - self.words)
        head, *cells = ([re.sub(r"([\\|<`*])", r"\\\1", cell) for cell in row] for row in self._lines)
        table = "".join(f"| {' | '.join(row)} |\n" for row in (head, rule, *cells))
        return table + (f"\n{one_line(self.caption)}\n" if self.caption else "")

    def latex(self) -> str:
        """The LaTeX table environment; it needs the package booktabs."""
        alignment = "l" * self.words + "r" * (len(self.columns) - self.words)
        head, *body = (" & ".join(map(latex_escaped, row)) + r" \\" for row in self._lines)
        lines = [r"\toprule", head, r"\midrule", *body, r"\bottomrule"]
        return "\n".join(
            (
                r"\begin{table}",
                r"  \centering",
                f"  \\begin{{tabular}}{{{alignment}}}",
                *(f"    {line}" for line in lines),
                r"  \end{tabular}",
                f"  \\caption{{{latex_escaped(self.caption)}}}",
                r"\end{table}",
                "",
            )
        )

    def rich(self, width: int) -> list[RichTable]:
        """Tables for a terminal of `width` characters: as many as the columns need, each with the key columns."""
        from rich import box
        from rich.table import Table as RichTable
        from rich.text import Text

        names, *rows = self._lines
        widths = [_width(column) for column in zip(names, *rows, strict=True)]
        widths[: self.keys] = [min(wide, max(width // (2 * self.keys), 12)) for wide in widths[: self.keys]]
        tables = []
        for columns in _blocks(widths, self.keys, width):
            table = RichTable(box=box.SIMPLE, pad_edge=False)
            for number in columns:
                table.add_column(
                    Text(names[number]),
                    justify="left" if number < self.words else "right",
                    width=widths[number],
                    overflow="fold",
                )
            for row in rows:
                table.add_row(*(Text(row[number]) for number in columns))
            tables.append(table)
        return tables

    def html(self) -> str:
        """The table for a notebook."""
        head, *body = ([escape(cell) for cell in row] for row in self._lines)
        cells = "".join(f"<tr><td>{'</td><td>'.join(row)}</td></tr>" for row in body)
        caption = f"<p>{escape(self.caption)}</p>" if self.caption else ""
        return (
            f"<table><thead><tr><th>{'</th><th>'.join(head)}</th></tr></thead><tbody>{cells}</tbody></table>{caption}"
        )

    @property
    def _lines(self) -> Sequence[Sequence[str]]:
        return [[one_line(cell) for cell in row] for row in (self.columns, *self.rows)]


def latex_escaped(text: str) -> str:
    """Text as LaTeX shows it as it is, on one line."""
    return "".join(_LATEX.get(character, character) for character in one_line(text))


def _width(column: Sequence[str]) -> int:
    """Characters that a column needs: its name breaks at spaces, its cells do not."""
    from rich.cells import cell_len

    name, *cells = column
    return max(map(cell_len, (*name.split(), *cells)), default=1)


def _blocks(widths: Sequence[int], keys: int, width: int) -> list[list[int]]:
    """Numbers of columns that fit beside each other, three spaces apart, after the key columns."""
    key = list(range(keys))
    blocks = [list(key)]
    for number in range(keys, len(widths)):
        if len(blocks[-1]) > keys and sum(widths[n] + 3 for n in (*blocks[-1], number)) > width:
            blocks.append(list(key))
        blocks[-1].append(number)
    return blocks
