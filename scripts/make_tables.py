"""Say which tables of the docs are older than the code that they measure, and make them again.

`make table-ages` lists how old they are. `make tables` makes all again, which takes hours and the recordings in the
folder FVSLAM_DATA; `python scripts/make_tables.py make installs.md` makes one, `make --older` those that are older than
their code. A table is put into its page as soon as it is made, and its runs are kept in build/tables.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from typing import Annotated

import typer
from one_sentence import one_sentence
from pages import ROOT, MarkedTable, marked_tables, pages, put

from fvslam_graph.core.errors import FvslamError
from fvslam_graph.study.spec import load_study

DATA = os.environ.get("FVSLAM_DATA", "../shared/data")
CURRENT = "as the code is"

app = typer.Typer()


@app.command()
def ages() -> None:
    """List all tables, with how many commits to their code have come since."""
    for table in _all():
        typer.echo(f"{table.page.relative_to(ROOT)}: {table.name}: {age(table, ROOT)}")


@app.command()
def make(
    names: Annotated[list[str] | None, typer.Argument(help="Of tables; all if not given.")] = None,
    older: Annotated[bool, typer.Option("--older", help="Only those that are older than their code.")] = False,
) -> None:
    """Measure tables again and put them into their pages; one that fails is left as it was."""
    tables = [table for table in _all() if not names or table.name in names]
    if unknown := set(names or ()) - {table.name for table in tables}:
        raise FvslamError(f"no page has a table {', '.join(sorted(unknown))}")
    if older:
        tables = [table for table in tables if age(table, ROOT) != CURRENT]
    try:
        failed = list(_failures(tables))
    except KeyboardInterrupt:
        raise FvslamError(
            "stopped; what was made is in its page, and `make --older` goes on with the others and with their runs"
        ) from None
    if failed:
        raise FvslamError("\n  ".join([f"{len(failed)} of {len(tables)} tables are left as they were:", *failed]))


def age(table: MarkedTable, root: Path) -> str:
    """Say in words whether a table is from the code as it is committed."""
    if not table.commit:
        return "not made yet"
    if table.joined:
        return f"as old as those of {' '.join(table.code)}"
    since = _git(root, "log", "--format=%h", f"{table.commit}..HEAD", "--", *table.code)
    if since.returncode:
        return f"its commit {table.commit} is not in this repository"
    count = len(since.stdout.split())
    return CURRENT if not count else f"older: {count} commits to {' '.join(table.code)} since {table.commit}"


def _all() -> list[MarkedTable]:
    """All tables, those that are joined from others last."""
    return sorted((table for page in pages(ROOT) for table in marked_tables(page)), key=lambda table: table.joined)


def _failures(tables: Sequence[MarkedTable]) -> Iterator[str]:
    """Make tables; for each that fails, a line that says why."""
    for number, table in enumerate(tables, 1):
        typer.echo(f"{number} of {len(tables)}: {table.name}")
        try:
            minutes = _made(table)
        except FvslamError as error:
            typer.echo(f"{table.name}: {error}", err=True)
            yield f"{table.name}: {error}"
        else:
            typer.echo(f"{table.name}: made in {minutes:.1f} minutes of CPU")


def _made(table: MarkedTable) -> float:
    """Run the command of a table and put what it wrote into the page; minutes of CPU.

    Raises:
        FvslamError: Its code is not committed, a recording is missing, or the command fails or writes no table.
    """
    if not table.joined and _git(ROOT, "status", "--porcelain", "--", *table.code).stdout:
        raise FvslamError(f"it is to say from which commit it is; commit {' '.join(table.code)} first")
    if missing := [str(path) for path in _inputs(table.command) if not path.exists()]:
        raise FvslamError(f"there is no {', '.join(missing)}; FVSLAM_DATA names the folder of the recordings")
    out = ROOT / "build" / "tables"
    out.mkdir(parents=True, exist_ok=True)
    written = out / table.name
    written.unlink(missing_ok=True)  # that of another time
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    before = getrusage(RUSAGE_CHILDREN)
    command = table.command.format(data=DATA, out=out)
    done = subprocess.run(command, shell=True, cwd=ROOT, env=os.environ | {"PATH": path})
    after = getrusage(RUSAGE_CHILDREN)
    if done.returncode or not written.is_file():
        why = f"ended with exit code {done.returncode}" if done.returncode else "wrote no such file"
        raise FvslamError(f"its command {why}: {command}")
    commit = _git(ROOT, "rev-parse", "--short", "HEAD").stdout.strip()
    put(replace(table, markdown=written.read_text(), commit=commit))
    return (after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime) / 60


def _inputs(command: str) -> Iterator[Path]:
    """Recordings, and trajectories of other systems, that a command reads."""
    for path in re.findall(r"\{data\}/[^\s\"']+", command):
        yield ROOT / path.format(data=DATA)
    for file in re.findall(r"studies/\w+\.yaml", command):
        study = load_study(ROOT / file)
        yield from (Path(source.path) for source in study.sequences if not source.is_synthetic)
        yield from (Path(path.split("@")[0]) for systems in study.external.values() for path in systems.values())


def _git(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command: Sequence[str] = ("git", "-C", str(root), *arguments)
    return subprocess.run(command, capture_output=True, text=True)


if __name__ == "__main__":
    with one_sentence():
        app()
