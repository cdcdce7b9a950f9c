"""Reading text files that people hand over."""

from __future__ import annotations

from pathlib import Path

from fvslam_graph.core.errors import FvslamError

MAX_TEXT_SIZE = 50_000_000  # bytes; as words, a table takes twenty times the memory
OWN_MAX_SIZE = 1_000_000_000  # bytes, of what a long run writes


def read_text(path: Path, error: type[FvslamError], max_size: int = MAX_TEXT_SIZE) -> str:
    """The text of a UTF-8 file, with or without a byte order mark.

    Raises:
        error: The file is missing, no regular file (a pipe would wait for ever), too large or no text.
    """
    try:
        if not path.exists():
            raise error(f"{path} is missing")
        if not path.is_file():
            raise error(f"{path} is {'a folder' if path.is_dir() else 'no regular file'}, a text file is expected")
        if (size := path.stat().st_size) > max_size:
            raise error(f"{path} has {size / 1e6:.0f} MB, at most {max_size / 1e6:.0f} MB of text are read")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as problem:
        raise error(f"{path} cannot be read as text: {problem}") from None
    if "\0" in text:
        raise error(f"{path} cannot be read as text: it holds NUL bytes, was it written to its end?")
    return text
