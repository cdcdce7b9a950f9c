"""Libraries that only some users need: what is missing is one sentence."""

from collections.abc import Iterator
from contextlib import contextmanager

from fvslam_graph.core.errors import FvslamError


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Turns an ImportError of the block, which imports what the extra `name` installs, into a FvslamError."""
    try:
        yield
    except ImportError as error:
        library = (error.name or "a library").partition(".")[0]
        raise FvslamError(f"{library} is not installed; `pip install fvslam-graph[{name}]` brings it") from None
