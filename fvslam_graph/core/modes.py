"""The names of estimators, fusion rules and trackers: ours, and those of other packages."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator

from fvslam_graph.core.choices import Mode
from fvslam_graph.core.plugins import Kind, Plugin, find

MODES = tuple(mode.value for mode in Mode)
TRACKERS = ("klt", "ncc")

_ODOMETRY = ("features", "vo", "scale")
# The groups of settings, and settings of groups that a mode reads in part.
_READ: dict[str, tuple[str, ...]] = {
    Mode.VO: _ODOMETRY,
    Mode.VSLAM: (*_ODOMETRY, "slam"),
    Mode.AVERAGE: (*_ODOMETRY, "slam", "fusion.weight", "fusion.geodesic"),
    Mode.INTERSECTION: (*_ODOMETRY, "slam", "fusion.criterion"),
    Mode.GRAPH: (*_ODOMETRY, "slam", "graph"),
}


def reads(mode: str | Plugin, setting: str) -> bool:
    """Whether the outcome of a mode depends on a setting, or on a group of them: "graph.lag", or "graph".

    Rules of other packages fuse what our odometry and visual SLAM say; estimators of theirs read none.
    """
    outside = outside_mode(mode) if isinstance(mode, str) else mode
    rule = (*_ODOMETRY, "slam") if outside is not None and outside.kind is Kind.RULE else ()
    return any(
        f"{setting}.".startswith(f"{part}.") or part.startswith(f"{setting}.") for part in _READ.get(str(mode), rule)
    )


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
