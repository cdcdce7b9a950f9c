"""Say which tables of the docs are older than the code that they measure, and make them again.

`make table-ages` lists how old they are. `make tables` makes all again, which takes hours and the recordings in the
folder FVSLAM_DATA; `python scripts/make_tables.py make installs.md` makes one.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from pages import ROOT, MarkedTable, marked_tables, pages, put

from fvslam_graph.core.errors import FvslamError

DATA = os.environ.get("FVSLAM_DATA", "../shared/data")

app = typer.Typer()


@app.command()
def ages() -> None:
    """List all tables, with how many commits to their code have come since."""
    for table in _all():
        typer.echo(f"{table.page.relative_to(ROOT)}: {table.name}: {age(table)}")


@app.command()
def make(names: Annotated[list[str] | None, typer.Argument(help="Of tables; all if not given.")] = None) -> None:
    """Measure tables again and put them into their pages; then list what is still older than its code."""
    tables = [table for table in _all() if table.command and (not names or table.name in names)]
    if missing := set(names or ()) - {table.name for table in tables}:
        raise FvslamError(f"no page has a table {', '.join(sorted(missing))} that a command makes")
    failed = [table.name for table in tables if not _made(table)]
    ages()
    if failed:
        raise FvslamError(f"left as they were, since their commands failed: {', '.join(failed)}")


def age(table: MarkedTable, root: Path = ROOT) -> str:
    """Say in words whether a table is from the code as it is committed."""
    if not table.commit:
        return "not made yet"
    if table.joined:
        return f"as old as those of {' '.join(table.code)}"
    since = _git(root, "log", "--format=%h", f"{table.commit}..HEAD", "--", *table.code)
    if since.returncode:
        return f"its commit {table.commit} is not in this repository"
    count = len(since.stdout.split())
    by = "" if table.command else ", and no command makes it again"
    return (
        "as the code is" if not count else f"older: {count} commits to {' '.join(table.code)} since {table.commit}{by}"
    )


def _all() -> list[MarkedTable]:
    """All tables, those that are joined from others last."""
    return sorted((table for page in pages() for table in marked_tables(page)), key=lambda table: table.joined)


def _made(table: MarkedTable) -> bool:
    """Run the command of a table and put what it wrote into the page; False where it fails."""
    if not table.joined and _git(ROOT, "status", "--porcelain", "--", *table.code).stdout:
        raise FvslamError(f"{table.name} is to say from which commit it is; commit {' '.join(table.code)} first")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    with tempfile.TemporaryDirectory() as folder:
        command = table.command.format(data=DATA, out=folder)
        done = subprocess.run(command, shell=True, cwd=ROOT, env=os.environ | {"PATH": path})
        written = Path(folder) / table.name
        if done.returncode or not written.is_file():
            return False
        commit = _git(ROOT, "rev-parse", "--short", "HEAD").stdout.strip()
        put(replace(table, markdown=written.read_text(), commit=commit))
    return True


def _git(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command: Sequence[str] = ("git", "-C", str(root), *arguments)
    return subprocess.run(command, capture_output=True, text=True)


if __name__ == "__main__":
    try:
        app()
    except FvslamError as error:
        sys.exit(f"make_tables: {error}")
