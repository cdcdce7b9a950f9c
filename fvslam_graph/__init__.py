"""Monocular visual odometry, EKF visual SLAM and their fusion, side by side and measured."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fvslam_graph import testing
    from fvslam_graph.api import compare, evaluate, run

__version__ = "0.1.0"
__all__ = ["compare", "evaluate", "run", "testing"]


def __getattr__(name: str) -> Any:
    """Import what computes when it is asked for, so that `fvslam --help` is quick."""
    if name == "testing":
        return import_module("fvslam_graph.testing")
    if name in __all__:
        return getattr(import_module("fvslam_graph.api"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
