"""Archives are unpacked into one folder and nowhere else, and what is there already stays."""

from __future__ import annotations

import gzip
import shutil
import tarfile
import zipfile
import zlib
from pathlib import Path, PurePosixPath, PureWindowsPath

from fvslam_graph.core.errors import DatasetError

STAGING = ".unpacking"
_CHUNK = 2**20  # bytes


def unpack(archive: Path, folder: Path) -> None:
    """Unpack a zip or tar archive; files that exist are left as they are.

    Args:
        archive: The file.
        folder: Where to; what an unpacking that was stopped has left there is removed.

    Raises:
        DatasetError: The archive is damaged, or has a file that would land elsewhere.
        OSError: The folder cannot be written.
    """
    staging = folder / STAGING
    shutil.rmtree(staging, ignore_errors=True)
    staging.mkdir()
    try:
        if zipfile.is_zipfile(archive):
            _unzip(archive, staging)
        else:
            _untar(archive, staging)
        for path in sorted(staging.rglob("*")):
            place = folder / path.relative_to(staging)
            if path.is_dir() and not path.is_symlink():
                place.mkdir(exist_ok=True)
            elif not place.exists():
                path.rename(place)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _unzip(archive: Path, folder: Path) -> None:
    try:
        with zipfile.ZipFile(archive) as file:
            for name in file.namelist():
                if PureWindowsPath(name).anchor or ".." in PurePosixPath(name.replace("\\", "/")).parts:
                    raise DatasetError(
                        f"{archive} has a file outside of its folder, '{name}'; nothing of it is unpacked"
                    )
            file.extractall(folder)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise DatasetError(f"{archive} is damaged: {error}") from None


def _untar(archive: Path, folder: Path) -> None:
    if not hasattr(tarfile, "data_filter"):
        raise DatasetError("Python 3.11.4 or later is needed to unpack a tar archive safely")
    try:
        with tarfile.open(archive) as file:
            file.extractall(folder, filter="data")
            while file.fileobj is not None and file.fileobj.read(_CHUNK):  # the checksum of gzip is at its end
                pass
    except tarfile.FilterError as error:
        raise DatasetError(f"{archive} has a file outside of its folder; nothing of it is unpacked ({error})") from None
    except (tarfile.TarError, gzip.BadGzipFile, zlib.error, EOFError) as error:
        raise DatasetError(f"{archive} is damaged: {error}") from None
