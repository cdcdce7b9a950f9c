"""Monocular visual odometry, EKF visual SLAM and their fusion, side by side and measured."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fvslam_graph.api import compare, evaluate, run

__version__ = "0.1.0"
__all__ = ["compare", "evaluate", "run"]


def __getattr__(name: str) -> Any:
    """Import what computes when it is asked for, so that `fvslam --help` is quick."""
    if name in __all__:
        from fvslam_graph import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
