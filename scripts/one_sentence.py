"""What a script says when it cannot go on."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fvslam_graph.core.errors import FvslamError


@contextmanager
def one_sentence() -> Iterator[None]:
    """End the script with what an error of the package says, and exit code 1."""
    try:
        yield
    except FvslamError as error:
        sys.exit(f"{Path(sys.argv[0]).stem}: {error}")
