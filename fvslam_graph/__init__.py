"""Monocular visual odometry, EKF visual SLAM and their fusion, side by side and measured."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fvslam_graph import testing
    from fvslam_graph.api import Estimator, compare, evaluate, export, run
    from fvslam_graph.core.camera import Camera
    from fvslam_graph.core.sequence import Ground

__version__ = "0.1.0"
__all__ = ["Camera", "Estimator", "Ground", "compare", "evaluate", "export", "run", "testing"]
_ELSEWHERE = {"Camera": "core.camera", "Ground": "core.sequence"}


def __getattr__(name: str) -> Any:
    """Import what computes when it is asked for, so that `fvslam --help` is quick."""
    if name == "testing":
        return import_module("fvslam_graph.testing")
    if name in __all__:
        return getattr(import_module(f"fvslam_graph.{_ELSEWHERE.get(name, 'api')}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
