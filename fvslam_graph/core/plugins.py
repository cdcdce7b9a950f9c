"""What other packages add: found by their entry points, or by a path such as `mypkg.fusion:MyRule`.

The groups of entry points are `fvslam_graph.formats`, `.fusion_rules`, `.trackers` and `.estimators`.
"""

from __future__ import annotations

import hashlib
import inspect
import re
import sys
from collections.abc import Collection
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import FunctionType
from typing import Any

from fvslam_graph.core.errors import ConfigError

Origin = dict[str, str | None]
"""Where something comes from: `name`, `distribution`, `version`, and a hash of its `source`."""


class Kind(StrEnum):
    """The kinds of things that other packages may add."""

    FORMAT = "format"
    RULE = "fusion rule"
    TRACKER = "tracker"
    ESTIMATOR = "estimator"

    @property
    def group(self) -> str:
        """The group of entry points."""
        return f"fvslam_graph.{self.replace(' ', '_')}s"


# What an object of each kind is asked for, and what its class is made with.
_METHODS: dict[Kind, dict[str, tuple[str, ...]]] = {
    Kind.FORMAT: {"matches": ("path",), "read": ("path",)},
    Kind.RULE: {"__call__": ("odometry", "slam")},
    Kind.TRACKER: {"track": ("image",), "set_keyframe": ("image", "kept")},
    Kind.ESTIMATOR: {"step": ("image", "stamp", "height"), "finish": ()},
}
_MADE_WITH: dict[Kind, tuple[str, ...]] = {
    Kind.FORMAT: (),
    Kind.RULE: (),
    Kind.TRACKER: ("settings",),
    Kind.ESTIMATOR: ("camera", "ground", "seed"),
}
_PATH = r"[\w.]+(:[\w.]+)?"  # of a module, and what is taken out of it
_FUNCTION = ("sequence", "seed")  # what an estimator that is a function is called with


@dataclass(frozen=True, eq=False)
class Plugin:
    """Something of another package, which fits its kind.

    Attributes:
        name: By which it was asked for.
        kind: What it is.
        object: A class, an object made already (a module is one), or, of an estimator, a function of a sequence and a
            seed.
        origin: For hashes and run.json.
    """

    name: str
    kind: Kind
    object: Any
    origin: Origin

    def __str__(self) -> str:
        return self.name

    @property
    def is_method(self) -> bool:
        """Whether it is a function of a whole sequence."""
        return self.kind is Kind.ESTIMATOR and not isinstance(self.object, type)

    def make(self, *arguments: Any) -> Any:
        """An object of the class; what is made already is returned as it is."""
        return self.object(*arguments) if isinstance(self.object, type) else self.object


def find(name: str, kinds: Collection[Kind], ours: Collection[str]) -> Plugin | None:
    """What another package adds by this name; None where no package does.

    Args:
        name: Of an entry point, or a path `package.module:Name`.
        kinds: What it may be.
        ours: Names that this package uses itself.

    Raises:
        ConfigError: It cannot be imported or does not fit, or somebody else has the same name.
    """
    if ":" in name:
        return _loaded(name, tuple(kinds), EntryPoint(name, name, ""))
    found = [(kind, entry) for kind in kinds for entry in _entries(kind) if entry.name == name]
    if not found:
        return None
    if name in ours or len(found) > 1:
        who = " and ".join(_owner(entry) for _, entry in found)
        other = "one of ours is called so, too" if name in ours else "only one can"
        raise ConfigError(
            f"{who} has {_with_article(found[0][0])} called '{name}', but {other}; give it as "
            f"{found[0][1].value}, and rename or uninstall it"
        )
    return _loaded(name, (found[0][0],), found[0][1])


def of_method(name: str, function: Any) -> Plugin:
    """A function of a sequence and a seed as an estimator; where it cannot be imported by its name, `source` is None.

    Raises:
        ConfigError: It cannot be called so.
    """
    if isinstance(function, type) or not callable(function) or not accepts(function, len(_FUNCTION)):
        raise ConfigError(
            f"{name} cannot be called with ({', '.join(_FUNCTION)}); a class is given as a text, package.module:Name"
        )
    module, place = getattr(function, "__module__", None), getattr(function, "__qualname__", "<none>")
    path = f"{module}:{place}"
    known = isinstance(function, FunctionType) and module != "__main__" and "<" not in place
    nowhere: Origin = {"name": path, "distribution": None, "version": None, "source": None}
    return Plugin(name, Kind.ESTIMATOR, function, origin(path, function) if known else nowhere)


def names(kind: Kind) -> dict[str, str]:
    """All entry points of a kind by name, each with the package that adds it; nothing is imported."""
    return {entry.name: _owner(entry) for entry in _entries(kind)}


def origin(name: str, thing: Any, entry: EntryPoint | None = None) -> Origin:
    """Where a class, a function or an object comes from: by the packages that define and that name it.

    Args:
        name: By which it is known.
        thing: What it is.
        entry: The entry point or path that names it.
    """
    modules = [] if inspect.ismodule(thing) else [_named(thing).__module__]
    modules += [entry.module] if entry else []
    package = modules[-1].partition(".")[0]
    dist = entry.dist if entry else None
    if dist is None:
        entries = (other for kind in Kind for other in _entries(kind))
        dist = next((other.dist for other in entries if other.module.partition(".")[0] == package), None)
    return {
        "name": name,
        "distribution": dist.name if dist else None,
        "version": dist.version if dist else None,
        "source": source_hash(*dict.fromkeys(modules)),
    }


@cache
def source_hash(*modules: str) -> str:
    """A hash of the source of the packages, whole, that modules belong to."""
    digest = hashlib.blake2b(digest_size=16)
    for module in modules:
        root = sys.modules.get(module.partition(".")[0]) or sys.modules[module]
        files = [file for place in getattr(root, "__path__", ()) for file in sorted(Path(place).rglob("*.py"))]
        if not files and (file := getattr(root, "__file__", None)) is not None:
            files = [Path(file)]
        for file in files:
            digest.update(file.read_bytes())
    return digest.hexdigest()


@cache
def _entries(kind: Kind) -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=kind.group))


@cache
def _loaded(name: str, kinds: tuple[Kind, ...], entry: EntryPoint) -> Plugin:
    what = " or ".join(kinds)
    if not re.fullmatch(_PATH, entry.value):
        raise ConfigError(f"the {what} '{name}' has to be written as package.module:Name")
    try:
        thing = entry.load()
    except Exception as error:  # of whatever kind: it is somebody else's code that runs
        reason = " ".join(str(error).split()) or type(error).__name__
        advice = f"repair or uninstall {_owner(entry)}" if entry.dist else "is its package installed, or on PYTHONPATH?"
        raise ConfigError(f"the {what} '{name}' cannot be imported: {reason}; {advice}") from None
    kind = next((kind for kind in kinds if _seems(thing, kind)), None)
    if kind is None:
        wanted = ", ".join(f"{_with_article(kind)} has {_signatures(kind)}" for kind in kinds)
        raise ConfigError(f"{name} is no {what}: {wanted}")
    if (lack := _lack(thing, kind)) is not None:
        raise ConfigError(f"{name} is no {kind}: {lack}")
    return Plugin(name, kind, thing, origin(name, thing, entry))


def _seems(thing: Any, kind: Kind) -> bool:
    """Whether it is meant as of this kind."""
    if isinstance(thing, FunctionType):
        return kind is Kind.ESTIMATOR
    return all(_has(thing, method) for method in _METHODS[kind])


def _lack(thing: Any, kind: Kind) -> str | None:
    """What is missing for it to be of this kind; None where nothing is."""
    if isinstance(thing, FunctionType):
        return None if accepts(thing, len(_FUNCTION)) else f"such a function is called with ({', '.join(_FUNCTION)})"
    if kind is Kind.ESTIMATOR and not isinstance(thing, type):
        return "it is an object already; name its class, so that each run has an object of its own"
    for method, arguments in _METHODS[kind].items():
        needs_self = isinstance(thing, type) and isinstance(inspect.getattr_static(thing, method), FunctionType)
        if not accepts(getattr(thing, method), len(arguments) + needs_self):
            return f"its {method} does not take ({', '.join(arguments)})"
    if isinstance(thing, type) and not accepts(thing, len(_MADE_WITH[kind])):
        return f"its class has to be made with ({', '.join(_MADE_WITH[kind])})"
    if kind is Kind.FORMAT and not all(isinstance(getattr(thing, name, None), str) for name in ("FORMAT", "LAYOUT")):
        return "it needs the texts FORMAT, its name, and LAYOUT, the files that it looks for"
    return None


def accepts(function: Any, count: int) -> bool:
    """Whether something can be called with so many arguments."""
    try:
        inspect.signature(function).bind(*range(count))
    except TypeError:
        return False
    except ValueError:  # of builtins, whose signature is not known
        return True
    return True


def _has(thing: Any, method: str) -> bool:
    if inspect.ismodule(thing):
        return callable(getattr(thing, method, None))
    # Every class can be called, which says nothing of its objects.
    return any(callable(getattr(base, method)) for base in _named(thing).__mro__ if method in vars(base))


def _named(thing: Any) -> Any:
    """What has a module and a name: a class or a function itself, else the class of an object."""
    return thing if isinstance(thing, type | FunctionType) else type(thing)


def _signatures(kind: Kind) -> str:
    return " and ".join(f"{method}({', '.join(arguments)})" for method, arguments in _METHODS[kind].items())


def _with_article(kind: Kind) -> str:
    return f"an {kind}" if kind is Kind.ESTIMATOR else f"a {kind}"


def _owner(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else entry.value
