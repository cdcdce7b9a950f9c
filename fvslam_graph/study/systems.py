"""Other programs as methods: each is run on the images of a sequence, and its trajectory is a row beside ours."""

from __future__ import annotations

import hashlib
import json
import shlex
import shutil
import string
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, field_validator

from fvslam_graph import __version__
from fvslam_graph.core.errors import FvslamError, SequenceError, StudyError
from fvslam_graph.core.files import file_name, one_line, write_json, writing
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.runs.ownership import FolderKind, claimed
from fvslam_graph.runs.results import Run
from fvslam_graph.study.external import external_labels, external_row
from fvslam_graph.study.jobs import Row
from fvslam_graph.study.measured_process import Usage, run_measured
from fvslam_graph.study.sources import Source, fingerprint
from fvslam_graph.study.system_input import SystemInput, written_input

DEFAULT_LIMIT = 3600.0  # seconds
REQUIRED, OPTIONAL = ("images", "out"), ("times", "camera")
TRAJECTORY, STDOUT, STDERR, USAGE = "trajectory.tum", "stdout.txt", "stderr.txt", "usage.json"
_MAX_LINE = 200  # characters of what a program says of its failure
_TAIL = 10_000  # bytes of its output that are looked at


class System(BaseModel):
    """A program.

    Attributes:
        command: With `{images}`, `{out}` and, if wanted, `{times}` and `{camera}`, for which paths are put in; see
            `SystemInput`. It is split as by a shell, but run without one. It writes a TUM file to `{out}`, its stamps
            those of `{times}`.
        folder: Where it is run.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    command: str
    folder: str = "."

    @field_validator("command")
    @classmethod
    def _has_its_fields(cls, command: str) -> str:
        fields = {field for _, field, _, _ in string.Formatter().parse(command) if field is not None}
        words = shlex.split(command)
        if unknown := fields - {*REQUIRED, *OPTIONAL}:
            raise ValueError(f"'{{{min(unknown)}}}' is none of {_braced(*REQUIRED, *OPTIONAL)}")
        if missing := [field for field in REQUIRED if field not in fields]:
            raise ValueError(f"it lacks {_braced(*missing)}, for which a path is put in")
        if words[0].startswith("{"):
            raise ValueError("it begins with a path that is put in, not with a program")
        return command

    def below(self, folder: Path) -> Self:
        """The same where a relative folder is one of this folder."""
        return self.model_copy(update={"folder": str(folder.absolute() / Path(self.folder).expanduser())})

    def arguments(self, given: SystemInput, out: Path) -> list[str]:
        """Program and arguments with the paths."""
        paths = {name: str(path) for name, path in asdict(given).items()} | {"out": str(out)}
        return [word.format_map(paths) for word in shlex.split(self.command)]

    def depends_on(self) -> list[Any]:
        """The command, with size and time of the program and of the files that it names."""
        words = shlex.split(self.command)
        files = [Path(self.folder, word) for word in words] + [Path(shutil.which(words[0]) or words[0])]
        stats = [(str(file), file.stat()) for file in files if file.is_file()]
        return [self.command, self.folder, [[name, stat.st_size, stat.st_mtime_ns] for name, stat in stats]]


def run_systems(
    sources: Iterable[Source], systems: Mapping[str, System], limit: float, align: Alignment, folder: Path
) -> Iterator[tuple[Row, Run | None]]:
    """The row of each program on each sequence, one after another, and its trajectory where there is one.

    What came to its end before, with the same command, input and limit, is not run again.

    Args:
        sources: The sequences.
        systems: By name.
        limit: Seconds after which a program is killed.
        align: For the evaluation.
        folder: Where what they say and print is kept.

    Raises:
        ResultsError: The folder cannot be written, or holds something else.
    """
    for source in sources:
        try:
            sequence = source.open()
            known = [__version__, fingerprint(source), limit]
        except FvslamError as error:
            yield from ((_failed(name, source.label, str(error)), None) for name in systems)
            continue
        with ExitStack() as stack:
            given: SystemInput | None = None
            for name, system in systems.items():
                place = folder.absolute() / _folder_name(source.label, name, [*known, system.depends_on()])
                try:
                    if (usage := _usage(place)) is None:
                        given = given or stack.enter_context(written_input(sequence, folder.absolute() / "input"))
                        usage = _run(system, given, place, limit)
                except (StudyError, SequenceError) as error:
                    yield _failed(name, source.label, str(error)), None
                    continue
                yield _judged(name, place, sequence, align, usage)


def _run(system: System, given: SystemInput, place: Path, limit: float) -> Usage:
    """Run a program; raises StudyError where it fails."""
    with claimed(place, FolderKind.SYSTEM):
        with writing(place):
            for name in (TRAJECTORY, USAGE):
                (place / name).unlink(missing_ok=True)
        try:
            usage = run_measured(
                system.arguments(given, place / TRAJECTORY), Path(system.folder), limit, place / STDOUT, place / STDERR
            )
        except (OSError, ValueError) as error:
            raise StudyError(f"it cannot be begun: {error}") from None
        if usage.code is None:
            raise StudyError(f"it was killed after {limit:g} s, the limit for other systems")
        if usage.code != 0:
            raise StudyError(f"it ended with exit code {usage.code}{_last_words(place)}")
        if not (place / TRAJECTORY).is_file():
            raise StudyError(f"it wrote no trajectory{_last_words(place)}")
        return usage


def _judged(name: str, place: Path, sequence: Sequence, align: Alignment, usage: Usage) -> tuple[Row, Run | None]:
    """The row of a program that came to its end, kept where its trajectory is of use."""
    row, run = external_row(name, str(place / TRAJECTORY), sequence, align)
    with claimed(place, FolderKind.SYSTEM), writing(place):
        if run is None:
            (place / USAGE).unlink(missing_ok=True)
            return row, None
        write_json(place / USAGE, asdict(usage))
    return row | {"cpu_s": usage.cpu, "wall_s": usage.wall, "peak_mb": usage.peak_mb}, run


def _usage(place: Path) -> Usage | None:
    """What a program took that came to its end before; None where none did."""
    try:
        return Usage(**json.loads((place / USAGE).read_text()))
    except (OSError, ValueError, TypeError):
        return None


def _last_words(place: Path) -> str:
    """The last line that a program wrote to its standard error."""
    lines = (place / STDERR).read_bytes()[-_TAIL:].decode(errors="replace").split("\n")
    last = next((line for line in reversed(lines) if line.strip()), "")
    return f": {one_line(last).strip()[:_MAX_LINE]}" if last else ""


def _failed(name: str, sequence: str, reason: str) -> Row:
    return external_labels(name, sequence) | {"status": f"failed: {one_line(reason)}"}


def _folder_name(sequence: str, name: str, depends_on: list[Any]) -> str:
    digest = hashlib.blake2b(json.dumps(depends_on).encode(), digest_size=8).hexdigest()
    return f"{file_name(f'{sequence}-{name}')}-{digest}"


def _braced(*names: str) -> str:
    return ", ".join(f"{{{name}}}" for name in names)
