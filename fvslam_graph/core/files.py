"""Writing files so that a reader never meets half of one, and so that a failure is one sentence."""

import hashlib
import json
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from fvslam_graph.core.errors import ResultsError

MAX_NAME_LENGTH = 80  # characters of a file's name that are those of a label


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turns an OSError of the block, which writes into `folder`, into a ResultsError."""
    try:
        yield
    except OSError as error:
        raise ResultsError(f"{error.filename or folder} cannot be written: {error.strerror or error}") from None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file beside `path`, of the same suffix, that takes its place when the block ends."""
    temporary = path.with_name(f"writing_{path.name}")
    try:
        yield temporary
        temporary.replace(path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


def write_file(path: Path, content: str | bytes) -> None:
    """Replace a file, or leave it as it was."""
    with replacing(path) as temporary:
        temporary.write_bytes(content.encode(errors="backslashreplace") if isinstance(content, str) else content)


def write_json(path: Path, data: Any) -> None:
    """Replace a JSON file by `json_text`."""
    write_file(path, json_text(data, indent=2) + "\n")


def json_text(data: Any, indent: int | None = None) -> str:
    """Data as JSON; numbers that are not finite become null, since JSON has no word for them."""
    return json.dumps(_plain(data), indent=indent)


def file_name(label: str) -> str:
    """The name of a file or folder for a label, which no other label has: where letters are lost, a hash follows."""
    name = re.sub(r"[^a-zA-Z0-9._]+", "-", label)[:MAX_NAME_LENGTH].strip("-.")
    if name and name == label:
        return name
    digest = hashlib.blake2b(label.encode(errors="backslashreplace"), digest_size=4).hexdigest()
    return f"{name}-{digest}" if name else digest


def one_line(text: str) -> str:
    """The text on one line, what cannot be printed as its escape: names may hold anything."""
    characters = (" " if character.isspace() else character for character in text)
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in characters)


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
