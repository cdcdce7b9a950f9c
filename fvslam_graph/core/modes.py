"""The names of estimators, fusion rules and trackers: ours, and those of other packages."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator

from fvslam_graph.core.choices import Mode
from fvslam_graph.core.plugins import Kind, Plugin, find

MODES = tuple(mode.value for mode in Mode)
TRACKERS = ("klt", "ncc")


def outside_mode(name: str) -> Plugin | None:
    """The estimator or fusion rule of another package that is called so; None where it is one of MODES, or nothing.

    Raises:
        ConfigError: It cannot be imported or does not fit, or somebody else has the same name.
    """
    return find(name, (Kind.ESTIMATOR, Kind.RULE), MODES)


def outside_tracker(name: str) -> Plugin | None:
    """The tracker of another package that is called so; likewise."""
    return find(name, (Kind.TRACKER,), TRACKERS)


def known_mode(name: str) -> str:
    """The name of a mode.

    Raises:
        ValueError: Nothing is called so.
        ConfigError: As for `outside_mode`.
    """
    if outside_mode(name) is None and name not in MODES:
        raise ValueError(_unknown(MODES))
    return name


def _is_tracker(name: str) -> str:
    if outside_tracker(name) is None and name not in TRACKERS:
        raise ValueError(_unknown(TRACKERS))
    return name


def _unknown(ours: tuple[str, ...]) -> str:
    return f"it is none of {', '.join(ours)}, no installed package adds it, and it is no path like package.module:name"


ModeName = Annotated[str, AfterValidator(known_mode)]
"""One of MODES, or an estimator or fusion rule of another package."""
TrackerName = Annotated[str, AfterValidator(_is_tracker)]
"""One of TRACKERS, or a tracker of another package."""
