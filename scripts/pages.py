"""Tables in the pages of the docs, written by the scripts that measure them.

A measured table stands between two comments, of which the first says how it is made, on which code it depends, and from
which commit it is:

    <!-- table: weights-03-tuned.md
    command: python scripts/paper_weights.py {data}/kitti_odometry/sequences/03 --frames 0:350 --out {out}
    code: fvslam_graph scripts/paper_weights.py
    commit: 010bd29
    -->

    <!-- end of table -->

The command leaves the Markdown of the table in the folder `{out}`, as a file of that name. A table that is
joined from those of another page names that page as its code.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml
from rich.console import Console

from fvslam_graph.core.errors import FvslamError
from fvslam_graph.core.files import replacing
from fvslam_graph.evaluation.tables import Table

ROOT = Path(__file__).parents[1]
MARKED = re.compile(r"<!-- (table: .*?)-->\n(.*?)<!-- end of table -->", re.DOTALL)
KEYS = {"table", "command", "code", "commit"}


@dataclass(frozen=True)
class MarkedTable:
    """A table in a page.

    Attributes:
        page: Where it stands.
        name: The file that its command writes; no other table has this name.
        command: Makes it, in a shell, at the root of the repository; empty where no script does yet.
        code: Paths below the root that decide about its numbers.
        commit: At which it was made; empty if it has not been made yet.
        markdown: It.
    """

    page: Path
    name: str
    command: str
    code: tuple[str, ...]
    commit: str
    markdown: str

    @property
    def joined(self) -> bool:
        """Whether it is made of tables of the docs."""
        return all(path.endswith(".md") for path in self.code)

    def block(self) -> str:
        """The table with its comments, as the page has it."""
        head = (
            f"table: {self.name}\ncommand: {self.command}\ncode: {' '.join(self.code)}\ncommit: {self.commit}".rstrip()
        )
        return f"<!-- {head}\n-->\n\n{self.markdown.strip()}\n\n<!-- end of table -->"


def pages(root: Path = ROOT) -> list[Path]:
    """The README and all pages of the docs."""
    return [root / "README.md", *sorted((root / "docs").rglob("*.md"))]


def marked_tables(page: Path) -> Iterator[MarkedTable]:
    """The measured tables of a page.

    Raises:
        FvslamError: A comment does not say what it should.
    """
    for head, body in MARKED.findall(page.read_text()):
        says = yaml.load(head, yaml.BaseLoader)  # which leaves a commit of digits a text
        if set(says) != KEYS:
            raise FvslamError(f"{page}: a table's comment has the keys {', '.join(sorted(KEYS))}, not {sorted(says)}")
        code = tuple(says["code"].split())
        yield MarkedTable(page, says["table"], says["command"], code, says["commit"], body.strip())


def put(table: MarkedTable) -> None:
    """Write a table to its place in its page."""
    text = table.page.read_text()
    for found in MARKED.finditer(text):
        if yaml.load(found[1], yaml.BaseLoader)["table"] == table.name:
            with replacing(table.page) as file:
                file.write_text(text[: found.start()] + table.block() + text[found.end() :])


def save_table(out: Path, name: str, table: Table) -> None:
    """Write a table where `scripts/make_tables.py` looks for it, and print it."""
    out.mkdir(parents=True, exist_ok=True)
    (out / f"{name}.md").write_text(table.markdown())
    console = Console()
    console.print(*table.rich(console.width), table.caption, sep="\n")
