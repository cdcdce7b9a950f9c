"""The tables of the docs: all that is measured says how, and the commands put what they measure into the pages."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from fvslam_graph.core.errors import FvslamError

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "scripts"))
import make_tables  # noqa: E402
import one_sentence  # noqa: E402
import pages  # noqa: E402

PAGES = pages.pages()


class Repository:
    """A repository with one page, whose tables are made by tiny commands."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.page = folder, folder / "README.md"
        self.git("init")

    def git(self, *arguments: str) -> str:
        identity = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
        command = ["git", "-C", self.folder, *identity, *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    def commit(self, file: str, text: str) -> str:
        (self.folder / file).write_text(text)
        self.git("add", file)
        self.git("commit", "-m", text)
        return self.git("rev-parse", "--short", "HEAD")

    def write_page(self, **commands: str) -> None:
        tables = (
            pages.MarkedTable(self.page, f"{name}.md", command, (f"{name}.py",), "", "").block()
            for name, command in commands.items()
        )
        self.page.write_text("\n\n".join(("# A page", *tables, "The end.\n")))

    def tables(self) -> dict[str, pages.MarkedTable]:
        return {table.name: table for table in pages.marked_tables(self.page)}


@pytest.fixture
def repository(tmp_path, monkeypatch) -> Repository:
    monkeypatch.setattr(make_tables, "ROOT", tmp_path)
    return Repository(tmp_path)


def making(name: str) -> str:
    """A command that makes a table, and keeps count of how often it did."""
    return f"echo {name} >> done && echo '| {name} |' > {{out}}/{name}.md"


def test_tables_have_names_of_their_own_commands_and_code_that_exists():
    marked = [table for page in PAGES for table in pages.marked_tables(page)]
    names = [table.name for table in marked]
    assert len(set(names)) == len(names) >= 20
    assert sum(page.read_text().count("<!-- table:") for page in PAGES) == len(marked)
    for table in marked:
        assert table.command, table.name
        assert table.code and all((ROOT / path).exists() for path in table.code), table.name
        for script in re.findall(r"(?:scripts|studies)/\w+\.\w+", table.command):
            assert (ROOT / script).is_file(), table.name
            assert table.joined or script in table.code or script == "scripts/join_tables.py", table.name


def test_columns_of_numbers_stand_in_tables_that_are_made():
    for page in PAGES:
        assert "---:" not in pages.MARKED.sub("", page.read_text()), page


def test_joined_tables_say_what_the_tables_say_that_they_are_made_of(tmp_path):
    """They cost nothing to make: run their commands."""
    joined = [table for page in PAGES for table in pages.marked_tables(page) if table.joined]
    assert len(joined) >= 4
    for table in joined:
        command = table.command.replace("python", sys.executable, 1).format(out=tmp_path)
        subprocess.run(command, shell=True, cwd=ROOT, check=True, capture_output=True)
        assert (tmp_path / table.name).read_text().strip() == table.markdown, table.name


def test_a_table_is_put_into_its_place(repository):
    repository.write_page(one="python scripts/one.py --out {out}")
    (table,) = repository.tables().values()
    assert (table.name, table.code, table.commit, table.markdown) == ("one.md", ("one.py",), "", "")
    made = replace(table, markdown="| a |\n| --- |\n| 1 |\n", commit="1234567")
    pages.put(made)
    (found,) = repository.tables().values()
    assert found.markdown == made.markdown.strip() and found.commit == "1234567"
    text = repository.page.read_text()
    assert text.startswith("# A page\n") and text.endswith("\nThe end.\n")


def test_a_table_is_older_than_its_code(repository):
    first = repository.commit("code.py", "one")
    table = pages.MarkedTable(repository.page, "one.md", "", ("code.py",), first, "")
    assert make_tables.age(table, repository.folder) == "as the code is"
    repository.commit("other.py", "elsewhere")
    assert make_tables.age(table, repository.folder) == "as the code is"
    repository.commit("code.py", "two")
    assert make_tables.age(table, repository.folder).startswith("older: 1 commits to code.py")
    assert make_tables.age(replace(table, commit=""), repository.folder) == "not made yet"
    assert "not in this repository" in make_tables.age(replace(table, commit="0" * 7), repository.folder)


def test_a_table_that_fails_is_named_and_the_others_are_made(repository):
    repository.write_page(one="exit 3", two="true", three=making("three"), four="cat {data}/nowhere/03")
    head = repository.commit("three.py", "code")
    (repository.folder / "two.py").write_text("not committed")
    with pytest.raises(FvslamError) as failure:
        make_tables.make()
    summary, one, two, four = str(failure.value).splitlines()
    assert summary == "3 of 4 tables are left as they were:"
    assert "one.md: its command ended with exit code 3: exit 3" in one
    assert "two.md: it is to say from which commit it is; commit two.py first" in two
    assert re.search(r"four.md: there is no .*nowhere/03; FVSLAM_DATA names the folder of the recordings", four)
    assert {table.commit for name, table in repository.tables().items() if name != "three.md"} == {""}
    three = repository.tables()["three.md"]
    assert (three.markdown, three.commit) == ("| three |", head)


def test_what_was_written_at_another_time_is_no_table(repository):
    repository.write_page(one=making("one"))
    repository.commit("one.py", "code")
    make_tables.make()
    repository.write_page(one="true")
    with pytest.raises(FvslamError, match=r"one.md: its command wrote no such file"):
        make_tables.make()
    assert repository.tables()["one.md"].commit == ""


def test_recordings_and_trajectories_of_a_study_are_looked_for_before_it_is_run(repository):
    (repository.folder / "studies").mkdir()
    study = "sequences: [{path: ../a, name: a}, 'synthetic:uav']\nexternal: {a: {DSO: ../dso.tum@0.1}}\n"
    (repository.folder / "studies" / "some.yaml").write_text(study)
    found = list(make_tables._inputs("fvslam study studies/some.yaml --out {out}"))
    assert [path.resolve() for path in found] == [repository.folder / "a", repository.folder / "dso.tum"]


def test_only_what_is_asked_for_or_older_is_made(repository):
    repository.write_page(one=making("one"), two=making("two"))
    repository.commit("one.py", "code")
    repository.commit("two.py", "code")
    with pytest.raises(FvslamError, match=r"no page has a table three.md"):
        make_tables.make(["three.md"])
    make_tables.make(["one.md"])
    make_tables.make(older=True)  # the other one
    make_tables.make(older=True)  # none
    repository.commit("one.py", "changed")
    make_tables.make(older=True)
    assert (repository.folder / "done").read_text().split() == ["one", "two", "one"]


def test_stopped_it_keeps_what_is_made_and_goes_on_with_the_others(repository, monkeypatch):
    repository.write_page(one=making("one"), two=making("two"))
    repository.commit("one.py", "code")
    repository.commit("two.py", "code")
    run = subprocess.run

    def stopped(command, **options):
        if "two.md" in command:
            raise KeyboardInterrupt
        return run(command, **options)

    with monkeypatch.context() as patch, pytest.raises(FvslamError, match=r"^stopped; .*`make --older` goes on"):
        patch.setattr(subprocess, "run", stopped)
        make_tables.make()
    assert repository.tables()["one.md"].markdown and not repository.tables()["two.md"].markdown
    make_tables.make(older=True)
    assert (repository.folder / "done").read_text().split() == ["one", "two"]


def test_a_script_that_cannot_go_on_says_so_in_one_sentence(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["scripts/some.py"])
    with pytest.raises(SystemExit, match=r"^some: there is no recording$") as end, one_sentence.one_sentence():
        raise FvslamError("there is no recording")
    assert end.value.code == "some: there is no recording"  # which Python prints, and exits with 1
