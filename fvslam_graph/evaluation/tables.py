"""A table of text, for a terminal, Markdown and LaTeX."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
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
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1
    caption: str = ""

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

    def rich(self, across: bool = False) -> RichTable:
        """For the terminal; `across` makes a column of each row, which fits where there are few rows."""
        from rich.table import Table as RichTable
        from rich.text import Text

        names, *rows = zip(*self._lines, strict=True) if across else self._lines
        table = RichTable(caption=Text(one_line(self.caption)))
        for number, name in enumerate(names):
            left = number == 0 if across else number < self.words
            table.add_column(Text(name), justify="left" if left else "right")
        for row in rows:
            table.add_row(*map(Text, row))
        return table

    @property
    def _lines(self) -> Sequence[Sequence[str]]:
        return [[one_line(cell) for cell in row] for row in (self.columns, *self.rows)]


def latex_escaped(text: str) -> str:
    """Text as LaTeX shows it as it is, on one line."""
    return "".join(_LATEX.get(character, character) for character in one_line(text))
