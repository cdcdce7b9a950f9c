"""The docs: every public name is in the reference, and Python in pages compiles."""

import inspect
import pkgutil
import re
import shlex
import sys
from pathlib import Path

import pytest
import typer

import fvslam_graph
from fvslam_graph.cli import app

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "scripts"))
import pages  # noqa: E402

PAGES = pages.pages()
SNIPPETS = [
    pytest.param(page, code, id=f"{page.stem}-{number}")
    for page in PAGES
    for number, code in enumerate(re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL))
]
COMMANDS = [
    pytest.param(command, id=f"{page.stem}-{number}")
    for page in PAGES
    for number, command in enumerate(re.findall(r"^(?: {4})?fvslam (.*)$", page.read_text(), re.MULTILINE))
]
REFERENCE = "".join(page.read_text() for page in PAGES if page.parent.name == "reference")


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


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_of_a_page_have_the_options_that_it_gives_them(command):
    words = shlex.split(re.sub(r"[][|]", "", command), comments=True)
    main = typer.main.get_command(app)
    for word in words:
        found = getattr(main, "commands", {}).get(word)
        if found is None:
            break
        main, words = found, words[1:]
    known = {option for parameter in main.params for option in parameter.opts}
    assert main.name != "fvslam" and {word for word in words if word.startswith("--")} <= known


def test_there_are_snippets_and_commands():
    assert len(SNIPPETS) >= 5 and len(COMMANDS) >= 20


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=lambda page: page.stem)
def test_no_bullet_is_a_paragraph(page):
    bullets = re.findall(r"^ *[-*] (?:.+\n?(?: {2,}\S.*\n?)*)", page.read_text(), re.MULTILINE)
    assert not [bullet for bullet in bullets if len(bullet.split()) > 50]
