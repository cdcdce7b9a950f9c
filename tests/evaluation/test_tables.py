"""Names may hold anything; tables and figures show it as it is."""

import io
import warnings
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from fvslam_graph.evaluation.plots.runs import plot_runs
from fvslam_graph.evaluation.plots.style import MAX_NAME_IN_FIGURE, legible
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.runs.run_folder import read_run

from .conftest import MakeRun, drive

NAMES = ["$x^{$", "[red]", "[/red]", "a\nb", "back\\", "_hidden", "<b>", "`x` *y*", ":smile:", "%&#~^", "n" * 300]


def shown(table: Table, width: int) -> list[str]:
    """The lines of each of its parts."""
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(*table.rich(width))
    return console.export_text().splitlines()


@pytest.mark.parametrize("name", NAMES)
def test_a_terminal_shows_a_name_as_it_is(name: str) -> None:
    text = "\n".join(shown(Table((name, "n"), [[name, "1"]], 1, name), 5000))
    for part in name.split("\n"):
        assert text.count(part) >= 2


def test_a_terminal_shows_all_columns_in_its_width() -> None:
    columns = ("sequence", "mode", *(f"error {n} (deg/100 m)" for n in range(12)))
    numbers = [[f"{n}.{column:03d} (0.1-0.2)" for column in range(12)] for n in (1, 2)]
    rows = [[60 * "s", "intersection", *row] for row in numbers]
    lines = shown(Table(columns, rows, 2, keys=2), 80)
    assert max(map(len, lines)) <= 80
    text = "\n".join(lines)
    assert all(number in text for row in numbers for number in row)
    assert text.count("intersection") == 2 * text.count("mode") > 2
    assert len(shown(Table(columns[:4], [row[:4] for row in rows], 2, keys=2), 200)) < 11  # one part


def test_a_notebook_shows_a_name_as_it_is() -> None:
    assert "<td>&lt;b&gt;</td>" in Table(("a",), [["<b>"]]).html()


@pytest.mark.parametrize("name", NAMES)
def test_a_row_is_a_row(name: str) -> None:
    table = Table((name, "n"), [[name, "1"], ["[b]", "2"]], 1, name)
    lines = table.markdown().splitlines()
    assert [line.replace("\\|", "").count("|") for line in lines[:4]] == [3] * 4 and len(lines) == 6
    body = table.latex().splitlines()
    assert len(body) == 12 and sum(line.endswith(r"\\") for line in body) == 3
    assert not any(line.lstrip().startswith(("[", "*")) for line in body)  # an argument of the row before


def test_markdown_takes_nothing_for_its_own() -> None:
    assert Table(("a",), [["<b>|`*\\"]]).markdown().splitlines()[2] == r"| \<b>\|\`\*\\ |"


def test_names_in_figures() -> None:
    assert legible("_a") == " _a" and legible("a\nb") == "a b"
    assert len(legible("x" * 300)) == MAX_NAME_IN_FIGURE


def test_figures_of_runs_with_any_name(make_run: MakeRun) -> None:
    runs = [
        replace(read_run(make_run(f"run{n}", truth=drive(20), sequence="$x^{$\n[red] 飞行")), name=name)
        for n, name in enumerate(NAMES)
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the font has not all letters
        files = plot_runs(runs[:4], runs[0].folder / "plots", figures=("trajectory", "speed"), suffixes=(".svg",))
        plot_runs(runs[4:], runs[0].folder / "plots", figures=("error",), suffixes=(".svg",))
    drawn = files[0].read_text()
    assert "$x^{$" in drawn and "[/red]" in drawn and np.all([file.stat().st_size > 5000 for file in files])
