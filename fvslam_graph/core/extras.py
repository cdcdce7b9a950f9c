"""Libraries that only some users need: what is missing is one sentence, before any work is done."""

from __future__ import annotations

from importlib.util import find_spec

from fvslam_graph.core.errors import FvslamError

LIBRARIES = {
    "bags": ("rosbags",),
    "data": ("pooch",),
    "eval": ("evo", "matplotlib"),
    "geo": ("pymap3d",),
    "rerun": ("rerun",),
    "study": ("dask", "distributed", "evo", "jinja2", "matplotlib", "pandas", "psutil", "pyarrow"),
    "test": ("evo", "matplotlib", "pytest"),
}
"""What each extra installs, by the names of its modules."""


def require(extra: str) -> None:
    """Check that what an extra installs is there.

    Raises:
        FvslamError: A library of it is missing; the message says how to install it.
    """
    for library in LIBRARIES[extra]:
        if find_spec(library) is None:
            raise FvslamError(f"{library} is not installed; `pip install fvslam-graph[{extra}]` brings it")
