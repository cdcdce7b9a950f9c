"""What commands show while they work and when they are done."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeVar

import typer

if TYPE_CHECKING:
    from rich.console import RenderableType

    from fvslam_graph.evaluation.tables import Table

WIDE = 240  # characters of a line that is not broken

_T = TypeVar("_T")


def progress_bar(items: Iterable[_T], total: int, label: str) -> Iterator[_T]:
    """A bar on a terminal, nothing elsewhere."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import track

    console = Console(stderr=True)
    return iter(track(items, escape(label), total, console=console, disable=not console.is_terminal, transient=True))


@contextmanager
def telling(package: str) -> Iterator[None]:
    """Show what a package logs as it goes on, on a terminal."""
    from rich.console import Console
    from rich.markup import escape

    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    log = logging.getLogger(package)
    with console.status("") as status:
        handler = logging.Handler()
        handler.emit = lambda record: status.update(escape(record.getMessage()))  # type: ignore[method-assign]
        log.addHandler(handler)
        log.setLevel(logging.INFO)
        try:
            yield
        finally:
            log.removeHandler(handler)
            log.setLevel(logging.NOTSET)


@contextmanager
def kept(what: Callable[[], str]) -> Iterator[None]:
    """Say what is kept of the block, where it is stopped."""
    try:
        yield
    except KeyboardInterrupt:
        typer.echo(f"stopped: {what()}", err=True)
        raise


def show(content: RenderableType) -> None:
    """Print text or a table, no wider than the terminal; a file or a pipe counts as one of 80 characters."""
    from rich.console import Console

    Console(highlight=False, markup=False, emoji=False).print(content)


def show_table(table: Table, whole: bool = True) -> None:
    """Print a table in as many parts as its columns need, or the first of them."""
    from rich.console import Console

    parts = table.rich(Console().width)
    for part in parts if whole else parts[:1]:
        show(part)
    if not whole and len(parts) > 1:
        show("The other columns are in summary.md and in the report.")
    show(table.caption)


def show_facts(facts: Iterable[tuple[str, str]]) -> None:
    """Print names beside their values; a file or a pipe counts as a terminal of `WIDE` characters."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None)
    for name, value in facts:
        table.add_row(name, Text(value))
    Console(width=None if sys.stdout.isatty() else WIDE).print(table)
