"""Which folders are ours, by a mark in them; what is not is neither written over nor deleted."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Any

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.files import writing

MARK, LOCK = ".fvslam.json", ".fvslam.lock"
INFO = "run.json"
_MAKER = "fvslam_graph"


class FolderKind(StrEnum):
    """The kinds of folders that are ours."""

    RUN = "run"
    STUDY = "study"
    IMAGES = "set of rendered images"
    FIGURES = "figures"
    SYSTEM = "run of another system"
    DATASET = "published data set"


def kind_of(folder: Path) -> FolderKind | None:
    """The kind of a folder of ours; None where it is not ours.

    Where there is no mark, as in a copy without hidden files, `run.json` says that it is a run.
    """
    mark = _read(folder / MARK)
    if mark.get("made_by") == _MAKER and mark.get("kind") in list(FolderKind):
        return FolderKind(mark["kind"])
    versions = _read(folder / INFO).get("versions")
    return FolderKind.RUN if isinstance(versions, dict) and _MAKER in versions else None


@contextmanager
def claimed(folder: Path, kind: FolderKind, wait: bool = False) -> Iterator[None]:
    """Make a folder ours, and no other process's for as long as the block lasts; the same thread may claim it again.

    Args:
        folder: Created; must be empty or marked as of this kind.
        kind: What it is to hold.
        wait: For another process that has it to let go, instead of refusing.

    Raises:
        ResultsError: It holds something else, another process has it, or it cannot be written.
    """
    from filelock import FileLock, Timeout

    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        found = kind_of(folder)
        if found is None and {path.name for path in folder.iterdir()} - {MARK, LOCK}:
            raise ResultsError(
                f"{folder} holds files that are not of a {kind}; give another or an empty folder for the output"
            )
        if found not in (None, kind):
            raise ResultsError(f"{folder} is the folder of a {found}, not of a {kind}; give another one for the output")
        lock = FileLock(folder / LOCK, is_singleton=True)
        try:
            held = lock.acquire(blocking=wait)
        except Timeout:
            raise ResultsError(
                f"{folder} is in use by another process, which writes into it; wait for its end, or give another folder"
            ) from None
    with held:
        with writing(folder):
            _mark(folder, kind)
        yield


def claim_files(folder: Path, names: Iterable[str]) -> None:
    """Make a folder for figures of these names, unless somebody else's are in it.

    Raises:
        ResultsError: One exists in a folder that has no mark.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if kind_of(folder) is None:
        for name in names:
            if (folder / name).exists():
                raise ResultsError(
                    f"{folder / name} exists and was not written by fvslam; give another folder for the figures"
                )
        _mark(folder, FolderKind.FIGURES)


def disown(folder: Path) -> None:
    """Remove a folder of ours that holds nothing any more; what somebody else has put there keeps it."""
    if not {path.name for path in folder.iterdir()} - {MARK, LOCK}:
        for name in (MARK, LOCK):
            (folder / name).unlink(missing_ok=True)
        folder.rmdir()


def _mark(folder: Path, kind: FolderKind) -> None:
    if not (folder / MARK).exists() or kind_of(folder) is None:
        (folder / MARK).write_text(json.dumps({"made_by": _MAKER, "kind": kind}) + "\n")


def _read(path: Path) -> dict[str, Any]:
    """The content of a JSON file; nothing where it cannot be read."""
    try:
        content = json.loads(path.read_bytes()) if path.is_file() else {}
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}
