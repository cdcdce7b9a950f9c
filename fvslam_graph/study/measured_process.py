"""Another program as a process: its time and memory with those of its children, and an end to all of them."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import psutil

INTERVAL = 0.1  # seconds between two looks at its memory, at most
_SHARE = 0.1  # ... and of the time since its start, so that a short program is looked at, too
_MIN_INTERVAL = 0.002  # seconds
_PATIENCE = 5.0  # seconds for processes to go that were killed


@dataclass(frozen=True)
class Usage:
    """What a program took, with the processes that it began.

    Attributes:
        code: Its exit code; None where it was killed at the limit.
        wall: Seconds from its start to its end.
        cpu: Seconds of CPU; NaN on Windows, which does not tell those of children.
        peak_mb: Largest sum of their resident memory, megabytes, looked at every INTERVAL or more often; memory that
            several share counts for each.
    """

    code: int | None
    wall: float
    cpu: float
    peak_mb: float


def run_measured(command: Sequence[str], folder: Path, limit: float, stdout: Path, stderr: Path) -> Usage:
    """Run a program to its end, or to the limit; none of its processes is left, also where this one is interrupted.

    Args:
        command: Program and arguments.
        folder: Where it is run.
        limit: Seconds.
        stdout, stderr: Files for what it prints.

    Raises:
        OSError: It cannot be begun.
    """
    before, begin = _cpu_of_children(), time.perf_counter()
    with stdout.open("wb") as out, stderr.open("wb") as err:
        process = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            start_new_session=True,  # Ctrl-C is for this process, which ends the others
        )
    family = _Family(process.pid)
    try:
        while (passed := time.perf_counter() - begin) < limit:
            family.look()
            with suppress(subprocess.TimeoutExpired):
                process.wait(min(INTERVAL, max(_SHARE * passed, _MIN_INTERVAL), limit - passed))
                break
        wall = time.perf_counter() - begin
        code = process.poll()
    finally:
        left_over = family.kill()
        process.wait()
    return Usage(code, wall, _cpu_of_children() - before + left_over, family.peak / 1e6)


class _Family:
    """A process and all that it has begun, also those whose parent has gone.

    Attributes:
        peak: Bytes.
    """

    def __init__(self, pid: int) -> None:
        import psutil

        self.peak = 0
        self._pid = pid
        self._gone = psutil.Error
        self._members: list[psutil.Process] = []
        with suppress(psutil.Error):
            self._members.append(psutil.Process(pid))

    def look(self) -> None:
        """See who belongs to it, and how much memory they have."""
        found: dict[psutil.Process, None] = {}
        for member in self._members:  # of the first one nearly all descend: the others are looked at where they do not
            if member not in found:
                with suppress(self._gone):
                    found |= dict.fromkeys([member, *member.children(recursive=True)])
        self._members = list(found)
        memory = 0
        for member in self._members:
            with suppress(self._gone):
                memory += member.memory_info().rss
        self.peak = max(self.peak, memory)

    def kill(self) -> float:
        """End all that are still there; returns the seconds of CPU of those whose parent has not waited for them."""
        import psutil

        self.look()
        seconds = 0.0
        for member in self._members:
            with suppress(self._gone):
                if member.pid != self._pid:
                    times = member.cpu_times()
                    seconds += times.user + times.system
                member.kill()
        if os.name != "nt":
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._pid, signal.SIGKILL)  # those that were begun after the last look
        psutil.wait_procs([member for member in self._members if member.pid != self._pid], _PATIENCE)
        return seconds


def _cpu_of_children() -> float:
    """Seconds of CPU of all processes that this one has begun and waited for."""
    times = os.times()
    return float("nan") if os.name == "nt" else times.children_user + times.children_system
