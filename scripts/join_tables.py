"""Put numbers of several tables, or of many rows of one, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from one_sentence import one_sentence
from pages import ROOT, marked_tables, save_table

from fvslam_graph.evaluation.tables import Table

Cells = Annotated[list[str], typer.Option("--cell", help="Column whose median is shown; several are put together.")]
Name = Annotated[str, typer.Option(help="Of the new table.")]
Out = Annotated[Path, typer.Option(help="Folder for it.")]

app = typer.Typer()


@app.command()
def recordings(
    page: Annotated[Path, typer.Argument(help="Page that has a table for each recording, with the same rows.")],
    tables: Annotated[list[str], typer.Argument(help="NAME=LABEL of its tables.")],
    cell: Cells,
    name: Name,
    out: Out,
) -> None:
    """Make a table with a column for each of several, and a row for each of their rows."""
    found = {table.name: _rows(table.markdown) for table in marked_tables(ROOT / page)}
    labels = dict(pair.split("=", 1) for pair in tables)
    if missing := set(labels) - set(found):
        raise typer.BadParameter(f"{page} has no table {', '.join(sorted(missing))}")
    columns = [{next(iter(row.values())): _cell(row, cell) for row in found[table]} for table in labels]
    first = next(iter(found[next(iter(labels))][0]))
    rows = [[key, *(column.get(key, "") for column in columns)] for key in columns[0]]
    save_table(out, name, Table((first, *labels.values()), rows))


@app.command()
def pivot(
    file: Annotated[Path, typer.Argument(help="Page or summary.md of a study, whose table has a row for each pair.")],
    row: Annotated[list[str], typer.Option(help="Column whose values become rows; several are put together.")],
    column: Annotated[str, typer.Option(help="Column whose values become columns.")],
    cell: Cells,
    name: Name,
    out: Out,
    where: Annotated[str | None, typer.Option(help="Rows of the table that are used.", metavar="COLUMN=VALUE")] = None,
) -> None:
    """Make a table with a row for each value of some columns, and a column for each value of another."""
    lines = _rows(file.read_text())
    if missing := {*row, column, *cell} - set(lines[0]):
        raise typer.BadParameter(f"{file} has no column {', '.join(sorted(missing))}")
    if where is not None:
        key, value = where.split("=", 1)
        lines = [line for line in lines if line[key] == value]
    cells = {(" ".join(line[name] for name in row).strip(), line[column]): _cell(line, cell) for line in lines}
    down, across = (list(dict.fromkeys(names)) for names in zip(*cells, strict=True))
    rows = [[one, *(cells.get((one, other), "") for other in across)] for one in down]
    save_table(out, name, Table((" ".join(row), *across), rows))


def _rows(markdown: str) -> list[dict[str, str]]:
    """The rows of the first table of a text, by the names of its columns."""
    lines = [
        [cell.strip() for cell in line.strip("|").split(" |")] for line in markdown.splitlines() if line[:1] == "|"
    ]
    names, _, *rows = lines
    return [dict(zip(names, row, strict=True)) for row in rows]


def _cell(row: dict[str, str], names: Sequence[str]) -> str:
    """Medians of a row, without their ranges; what it does not have is left out."""
    medians = (row[name].split(" (")[0] for name in names)
    return " / ".join(median for median in medians if median != "-")


if __name__ == "__main__":
    with one_sentence():
        app()
