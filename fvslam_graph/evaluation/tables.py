"""A table of text, for a terminal, Markdown and LaTeX."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table as RichTable

_LATEX = {
    "\\": r"\textbackslash{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
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
        """As a Markdown table with the caption below."""
        rule = ["---"] * self.words + ["---:"] * (len(self.columns) - self.words)
        cells = ([cell.replace("|", "\\|") for cell in row] for row in self.rows)
        table = "".join(f"| {' | '.join(row)} |\n" for row in (self.columns, rule, *cells))
        return table + (f"\n{self.caption}\n" if self.caption else "")

    def latex(self) -> str:
        """As a LaTeX table environment; needs the package booktabs."""
        alignment = "l" * self.words + "r" * (len(self.columns) - self.words)
        head, *body = (" & ".join(map(_escaped, row)) + r" \\" for row in (self.columns, *self.rows))
        lines = [r"\toprule", head, r"\midrule", *body, r"\bottomrule"]
        return "\n".join(
            (
                r"\begin{table}",
                r"  \centering",
                f"  \\begin{{tabular}}{{{alignment}}}",
                *(f"    {line}" for line in lines),
                r"  \end{tabular}",
                f"  \\caption{{{_escaped(self.caption)}}}",
                r"\end{table}",
                "",
            )
        )

    def rich(self, across: bool = False) -> RichTable:
        """For the terminal; `across` makes a column of each row, which fits where there are few rows."""
        from rich.markup import escape
        from rich.table import Table as RichTable

        lines = [self.columns, *self.rows]
        names, *rows = zip(*lines, strict=True) if across else lines
        table = RichTable(caption=escape(self.caption))
        for number, name in enumerate(names):
            left = number == 0 if across else number < self.words
            table.add_column(escape(name), justify="left" if left else "right")
        for row in rows:
            table.add_row(*map(escape, row))
        return table


def _escaped(text: str) -> str:
    return "".join(_LATEX.get(character, character) for character in text)
