"""The docs: every public name is in the reference, Python in pages compiles, tables say where they come from."""

import inspect
import pkgutil
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import fvslam_graph

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "scripts"))
import make_tables  # noqa: E402
import pages  # noqa: E402

PAGES = pages.pages()
SNIPPETS = [
    pytest.param(page, code, id=f"{page.stem}-{number}")
    for page in PAGES
    for number, code in enumerate(re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL))
]
REFERENCE = "".join(page.read_text() for page in PAGES if page.parent.name == "reference")
SHORT = """# A page

<!-- table: one.md
command: python scripts/one.py --out {out}
code: code.py
commit:
-->

<!-- end of table -->

The end.
"""


@pytest.mark.parametrize("name", fvslam_graph.__all__)
def test_every_public_name_is_in_the_reference(name):
    assert f"::: fvslam_graph.{name}\n" in REFERENCE


@pytest.mark.parametrize("path", re.findall(r"^::: (\S+)", REFERENCE, re.MULTILINE))
def test_what_is_in_the_reference_has_docstrings(path):
    thing = pkgutil.resolve_name(path)
    module = thing.__name__ if inspect.ismodule(thing) else thing.__module__
    public = [part for name, part in vars(thing).items() if not name.startswith("_") and callable(part)]
    own = [part for part in (thing, *public) if inspect.ismodule(part) or part.__module__ == module]
    assert not [part for part in own if not part.__doc__]


@pytest.mark.parametrize(("page", "code"), SNIPPETS)
def test_python_of_a_page_compiles_and_imports_what_there_is(page, code):
    compile(code, str(page), "exec")
    imports = re.findall(r"^(?:import fvslam_graph|from fvslam_graph[\w.]* import .*)$", code, re.MULTILINE)
    exec("\n".join(imports), {})


def test_there_are_snippets():
    assert len(SNIPPETS) >= 5


def test_tables_have_names_of_their_own_and_code_that_exists():
    marked = [table for page in PAGES for table in pages.marked_tables(page)]
    names = [table.name for table in marked]
    assert len(set(names)) == len(names) >= 20
    assert sum(page.read_text().count("<!-- table:") for page in PAGES) == len(marked)
    for table in marked:
        assert table.code and all((ROOT / path).exists() for path in table.code), table.name
        for script in re.findall(r"(?:scripts|studies)/\w+\.\w+", table.command):
            assert (ROOT / script).is_file(), table.name


def test_joined_tables_say_what_the_tables_say_that_they_are_made_of(tmp_path):
    """They cost nothing to make: run their commands."""
    joined = [table for page in PAGES for table in pages.marked_tables(page) if table.joined]
    assert len(joined) >= 4
    for table in joined:
        command = table.command.replace("python", sys.executable, 1).format(out=tmp_path)
        subprocess.run(command, shell=True, cwd=ROOT, check=True, capture_output=True)
        assert (tmp_path / table.name).read_text().strip() == table.markdown, table.name


def test_a_table_is_put_into_its_place(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(SHORT)
    (table,) = pages.marked_tables(page)
    assert (table.name, table.code, table.commit, table.markdown) == ("one.md", ("code.py",), "", "")
    made = replace(table, markdown="| a |\n| --- |\n| 1 |\n", commit="1234567")
    pages.put(made)
    (found,) = pages.marked_tables(page)
    assert found.markdown == made.markdown.strip() and found.commit == "1234567"
    assert page.read_text().startswith("# A page\n") and page.read_text().endswith("\nThe end.\n")


def test_a_table_is_older_than_its_code(tmp_path):
    def git(*arguments):
        identity = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
        done = subprocess.run(
            ["git", "-C", tmp_path, *identity, *arguments], check=True, capture_output=True, text=True
        )
        return done.stdout.strip()

    def commit(file, text):
        (tmp_path / file).write_text(text)
        git("add", file)
        git("commit", "-m", text)
        return git("rev-parse", "--short", "HEAD")

    git("init")
    first = commit("code.py", "one")
    table = pages.MarkedTable(tmp_path / "page.md", "one.md", "", ("code.py",), first, "")
    assert make_tables.age(table, tmp_path) == "as the code is"
    commit("other.py", "elsewhere")
    assert make_tables.age(table, tmp_path) == "as the code is"
    commit("code.py", "two")
    assert make_tables.age(table, tmp_path).startswith("older: 1 commits to code.py")
    assert make_tables.age(replace(table, commit=""), tmp_path) == "not made yet"
    assert "not in this repository" in make_tables.age(replace(table, commit="0" * 7), tmp_path)
