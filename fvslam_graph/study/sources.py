"""What a study runs on: recordings and synthetic worlds by their path, and sequences in memory."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt, SkipValidation

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.files import file_name, replacing
from fvslam_graph.core.plugins import Kind, find
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.runs.ownership import kind_of
from fvslam_graph.sequences.open import open_sequence, sequence_name

MAX_RENDERED_SIZE = 2e9  # bytes of rendered images


class Source(BaseModel):
    """A recording or a synthetic world, as `open_sequence` takes it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    path: str
    name: str | None = None  # in tables; the sequence's own, if not given
    frames: str | None = None
    stride: PositiveInt = 1
    scale: float = Field(1.0, gt=0, le=1)
    camera_height: PositiveFloat | None = None
    camera_pitch: float | None = None
    recalibration: str | None = None
    format: str | None = None
    topic: str | None = None
    fov: float | None = None
    telemetry: str | None = None
    telemetry_offset: float | None = None

    @property
    def label(self) -> str:
        """The name in tables, also where the recording cannot be opened."""
        return self.name or sequence_name(self.path)

    @property
    def is_synthetic(self) -> bool:
        """Whether it is rendered."""
        return self.path.startswith("synthetic:")

    @property
    def can_be_sent(self) -> bool:
        """Whether other processes can open it."""
        return True

    @property
    def worth_keeping(self) -> bool:
        """Whether its images are had faster from one file than from where they are."""
        return self.is_synthetic

    def open(self) -> Sequence:
        """The sequence; raises as `open_sequence` does."""
        options = self.model_dump(exclude={"name"})
        if not self.is_synthetic:
            options["path"] = str(Path(self.path).expanduser().absolute())
        return replace(open_sequence(**options), name=self.label)

    def below(self, folder: Path) -> Self:
        """The same where a relative path is one of this folder."""
        if self.is_synthetic:
            return self

        def absolute(path: str) -> str:
            return str(folder.absolute() / Path(path).expanduser())

        return self.model_copy(
            update={
                "path": absolute(self.path),
                "telemetry": self.telemetry and absolute(self.telemetry),
                "recalibration": self.recalibration and absolute(self.recalibration),
            }
        )

    def content(self) -> Iterator[bytes]:
        """What tells its files from others: size and time of each."""
        for place in filter(None, (self.path, self.telemetry, self.recalibration)):
            path = Path(place).expanduser()
            for file in sorted(_files(path)):
                stat = file.stat()
                yield f"{file.relative_to(path)} {stat.st_size} {stat.st_mtime_ns}\n".encode()


class HeldSequence(Source):
    """A sequence in memory; what it can be opened with is not known, so that its images are its content."""

    held: SkipValidation[Any] = Field(exclude=True, repr=False)

    # Each is what it holds at one time, so that none is taken for another.
    __hash__ = object.__hash__
    __eq__ = object.__eq__

    @classmethod
    def of(cls, sequence: Sequence) -> Self:
        """Hold a sequence, which keeps its name."""
        return cls(path=f"memory:{sequence.name}", name=sequence.name, held=sequence)

    @property
    def can_be_sent(self) -> bool:
        """Whether there is room for its images in a file."""
        return _size(self.held) <= MAX_RENDERED_SIZE

    @property
    def worth_keeping(self) -> bool:
        """Other processes have no other way to it."""
        return True

    def open(self) -> Sequence:
        """The sequence."""
        sequence: Sequence = self.held
        return sequence

    def below(self, folder: Path) -> Self:
        """The same."""
        return self

    def without_images(self) -> HeldSequence:
        """What other processes are told, which find the images in a file."""
        return self.model_copy(update={"held": replace(self.held, load=_not_here)})

    def content(self) -> Iterator[bytes]:
        """All images."""
        for index in range(len(self.held)):
            image = self.held.load(index)
            yield b"none" if image is None else np.ascontiguousarray(image).tobytes()


def _not_here(index: int) -> None:
    raise SequenceError(f"image {index} could not be written for other processes; let the study run in one")


def render(source: Source, folder: Path) -> Path | None:
    """Write the images of a synthetic world into a file, since rendering takes longer than a run; or those in memory.

    Returns:
        The file; None for recordings, and for worlds that there is no room to keep.
    """
    sequence = source.open()
    if not source.worth_keeping or _size(sequence) > MAX_RENDERED_SIZE:
        return None
    size = (len(sequence), sequence.camera.height, sequence.camera.width)
    file = folder / f"{file_name(source.label)}.npz"
    try:
        images, usable = np.zeros(size, np.uint8), np.zeros(len(sequence), bool)
        for index in range(len(sequence)):
            image = sequence.load(index)
            if image is not None:
                images[index], usable[index] = image, True
        with replacing(file) as path:
            np.savez(path, images=images, usable=usable)
    except (OSError, ValueError, MemoryError):  # no room; zipfile complains of its own handle, too
        return None
    return file


@lru_cache(maxsize=1)  # jobs come sequence by sequence
def opened(source: Source, rendered: Path | None) -> Sequence:
    """The sequence, with images from the file that `render` has written, if any."""
    sequence = source.open()
    if rendered is None:
        return sequence
    with np.load(rendered) as file:
        images, usable = file["images"], file["usable"]
    return replace(sequence, load=lambda index: images[index] if usable[index] else None)


@cache
def fingerprint(source: Source) -> list[Any]:
    """The parts of a recording that numbers depend on: what is known of it, its content, and who reads its format."""
    sequence = source.open()
    truth = sequence.ground_truth
    known = [sequence.stamps, sequence.camera, sequence.ground and sequence.ground.heights, sequence.ground]
    known += [] if truth is None else [truth.stamps, truth.matrices]
    digest = hashlib.blake2b(digest_size=16)
    for fact in known:
        digest.update(fact.tobytes() if isinstance(fact, np.ndarray) else repr(fact).encode())
    for part in source.content():
        digest.update(part)
    outside = find(sequence.format, (Kind.FORMAT,), ())
    return [source.model_dump(exclude={"name"}), digest.hexdigest(), outside and outside.origin]


def _size(sequence: Sequence) -> int:
    """Bytes of all images."""
    return len(sequence) * sequence.camera.height * sequence.camera.width


def _files(path: Path) -> Iterator[Path]:
    """A file, or all files of a folder but those that we have written into it, which are no part of the recording."""
    if path.is_file():
        yield path
    for folder, inner, names in os.walk(path):
        inner[:] = [name for name in inner if kind_of(Path(folder, name)) is None]
        yield from (file for name in names if (file := Path(folder, name)).is_file())
