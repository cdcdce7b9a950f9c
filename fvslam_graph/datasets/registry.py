"""The published recordings that can be downloaded by name."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field

from fvslam_graph.core.errors import DatasetError
from fvslam_graph.core.yaml_files import read_yaml_mapping

_FILE = Path(__file__).with_name("published.yaml")


class Archive(BaseModel):
    """A file to download and unpack: zip or tar.

    Attributes:
        url: Where it is.
        gigabytes: About how large.
        sha256: Checksum, where its publisher gives one.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    url: str
    gigabytes: float
    sha256: str | None = Field(None, pattern="^[0-9a-f]{64}$")

    @property
    def name(self) -> str:
        """The name of the file."""
        return PurePosixPath(urlsplit(self.url).path).name


class Dataset(BaseModel):
    """A recording.

    Attributes:
        title: What it is.
        page: Of its publisher.
        licence: As stated there.
        open: What of it `open_sequence` takes.
        archives: Its files; none where they are given out through the page alone.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    title: str
    page: str
    licence: str
    open: str
    archives: tuple[Archive, ...]

    @property
    def size(self) -> str:
        """How large all files are."""
        return f"{sum(archive.gigabytes for archive in self.archives):.2g} GB" if self.archives else "by its page"


def published() -> dict[str, Dataset]:
    """All that can be downloaded, by name."""
    return {name: Dataset.model_validate(entry) for name, entry in read_yaml_mapping(_FILE, DatasetError).items()}


def find_dataset(name: str) -> Dataset:
    """The data set of a name.

    Raises:
        DatasetError: There is none.
    """
    known = published()
    if name not in known:
        raise DatasetError(f"no data set is called '{name}'; there are {', '.join(known)}")
    return known[name]
