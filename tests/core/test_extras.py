import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from fvslam_graph.core.errors import FvslamError
from fvslam_graph.core.extras import LIBRARIES, require

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]


def packages(extra: str) -> set[str]:
    """The names of the packages of an extra, with those of the extras that it names."""
    names = set()
    for requirement in EXTRAS[extra]:
        if own := re.match(r"fvslam-graph\[(.+)\]", requirement):
            names |= set().union(*(packages(part) for part in own[1].split(",")))
        else:
            names.add(re.match(r"[\w-]+", requirement)[0])
    return names


@pytest.mark.parametrize("extra", sorted(LIBRARIES))
def test_the_libraries_are_those_that_the_extra_installs(extra):
    distributions = packages_distributions()
    of_modules = {name.lower() for library in LIBRARIES[extra] for name in distributions[library]}
    assert of_modules - {"distributed"} == packages(extra)


def test_all_is_all():
    assert set(EXTRAS) == {*LIBRARIES, "all"}
    assert packages("all") == set().union(*map(packages, LIBRARIES))


def test_what_is_missing_is_said(monkeypatch):
    require("study")
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(FvslamError, match=r"^jinja2 is not installed; `pip install fvslam-graph\[study\]` brings it$"):
        require("study")
