"""A published recording comes into a folder: downloaded, held to its checksum, unpacked; stopped, it goes on."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any, Protocol

from fvslam_graph.core.errors import DatasetError
from fvslam_graph.core.extras import require
from fvslam_graph.core.files import write_json, writing
from fvslam_graph.datasets.registry import Archive, Dataset
from fvslam_graph.datasets.unpack import unpack
from fvslam_graph.runs.ownership import FolderKind, claimed

CHECKSUMS = "checksums.json"
DOWNLOADS = ".downloads"
TIMEOUT = 30.0  # seconds without an answer
_CHUNK = 2**14  # bytes
_UNSATISFIABLE_RANGE = 416  # HTTP: nothing is left to be sent


class Bar(Protocol):
    """Shows how far a download is, as pooch calls it."""

    total: int

    def update(self, count: int) -> None:
        """So many bytes have come."""

    def reset(self) -> None:
        """Begin anew."""

    def close(self) -> None:
        """No more come."""


def get_dataset(dataset: Dataset, folder: Path, bar: Bar | None = None) -> Path:
    """Bring a data set into a folder; what is there already is not brought again.

    Where its publisher gives no checksum, that of the first download is kept in CHECKSUMS, and holds from then on.

    Args:
        dataset: Which.
        folder: Created; must be empty, or that of an earlier call. Files in it are not replaced.
        bar: To show the progress.

    Returns:
        What `open_sequence` takes.

    Raises:
        DatasetError: It cannot be downloaded, or is not what it should be; what has come is gone on from.
        ResultsError: The folder holds something else, is in use, or cannot be written.
    """
    require("data")
    if not dataset.archives:
        raise DatasetError(
            f"{dataset.title} is given out through its page alone, {dataset.page}: download it there and unpack it "
            f"into {folder}"
        )
    with claimed(folder, FolderKind.DATASET), writing(folder):
        done = _read_checksums(folder)
        for archive in dataset.archives:
            if archive.url in done and (folder / dataset.open).exists():
                continue
            file = folder / DOWNLOADS / archive.name
            found = _download(archive, file, archive.sha256 or done.get(archive.url), bar)
            try:
                unpack(file, folder)
            except DatasetError:
                file.unlink()  # it is damaged: the next one begins anew
                raise
            file.unlink()
            done[archive.url] = found
            write_json(folder / CHECKSUMS, done)
    if not (folder / dataset.open).exists():
        raise DatasetError(f"{dataset.title}: its archives do not hold {dataset.open}; they are unpacked in {folder}")
    return folder / dataset.open


def _download(archive: Archive, file: Path, sha256: str | None, bar: Bar | None) -> str:
    """Download a file, or what is missing of it; returns its SHA-256."""
    import pooch

    part = file.with_name(f"{file.name}.part")
    file.parent.mkdir(exist_ok=True)

    def resume(url: str, output: str, _: object) -> None:
        _continue(url, part, bar)
        part.replace(output)
        part.with_name(f"{part.name}.version").unlink(missing_ok=True)

    pooch.get_logger().setLevel(logging.WARNING)
    try:
        pooch.retrieve(archive.url, sha256 and f"sha256:{sha256}", file.name, file.parent, downloader=resume)
    except ValueError:  # as which pooch says that checksums differ; it has removed the download
        raise DatasetError(
            f"{archive.url} is not the file that is expected, or came damaged: its SHA-256 is not {sha256}; it is not "
            "unpacked, and the same command begins anew"
        ) from None
    except OSError as error:
        if not hasattr(error, "request"):  # which those of the disk have not
            raise
        raise DatasetError(
            f"{archive.url} cannot be downloaded: {_reason(error)}; the same command goes on from there"
        ) from None
    found: str = pooch.file_hash(str(file))
    return found


def _continue(url: str, part: Path, bar: Bar | None) -> None:
    """Download what a file lacks; all of it where the server cannot send a part, or has another file by now."""
    import pooch

    version = part.with_name(f"{part.name}.version")  # the server's name for it
    with part.open("ab") as file:
        begin = file.tell()
        headers = {"Accept-Encoding": "identity"}
        if begin:
            headers["Range"] = f"bytes={begin}-"
        if begin and version.is_file():
            headers["If-Range"] = version.read_text()

        def begin_anew(response: Any, *_: object, **__: object) -> None:
            if response.status_code == 200:  # all of it, not a part
                file.truncate(0)
                version.unlink(missing_ok=True)
                if (etag := response.headers.get("ETag", "W/")).startswith('"'):  # others do not tell bytes apart
                    version.write_text(etag)

        downloader = pooch.HTTPDownloader(
            progressbar=bar or False,
            chunk_size=_CHUNK,
            timeout=TIMEOUT,
            headers=headers,
            hooks={"response": begin_anew},
        )
        try:
            downloader(url, file, None)
        except OSError as error:
            status = getattr(getattr(error, "response", None), "status_code", None)
            if not (begin and status == _UNSATISFIABLE_RANGE):
                raise


def _reason(error: OSError) -> str:
    """What went wrong between here and there."""
    response = getattr(error, "response", None)
    if response is not None:
        return f"the server answers {response.status_code} {response.reason}"
    return f"the connection fails ({type(error).__name__})"


def _read_checksums(folder: Path) -> dict[str, str]:
    """The SHA-256 of what was unpacked here, by its address."""
    try:
        content = json.loads((folder / CHECKSUMS).read_text())
    except (OSError, ValueError):
        return {}
    return {str(url): str(found) for url, found in content.items()} if isinstance(content, dict) else {}
