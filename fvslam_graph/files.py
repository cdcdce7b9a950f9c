"""Writing files so that a reader never meets half of one, and so that a failure is one sentence."""

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fvslam_graph.errors import ResultsError


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turns an OSError of the block, which writes into `folder`, into a ResultsError."""
    try:
        yield
    except OSError as error:
        raise ResultsError(f"{error.filename or folder} cannot be written: {error.strerror}") from None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file beside `path`, of the same suffix, that takes its place when the block ends."""
    temporary = path.with_name(f"writing_{path.name}")
    yield temporary
    temporary.replace(path)


def write_json(path: Path, data: Any) -> None:
    """Replace a JSON file; numbers that are not finite become null, since JSON has no word for them."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(_plain(data), indent=2) + "\n")


def _plain(value: Any) -> Any:
    match value:
        case Mapping():
            return {str(key): _plain(item) for key, item in value.items()}
        case list() | tuple():
            return [_plain(item) for item in value]
        case np.ndarray() | np.generic():
            return _plain(value.tolist())
        case float():
            return value if math.isfinite(value) else None
        case None | int() | str():
            return value
    return str(value)
