"""A run in a process of its own: its memory is that of no other run, and where it dies, it is a row."""

from __future__ import annotations

import _thread
import os
import pickle
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import IO, NoReturn

from fvslam_graph.core.errors import StudyError
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.study.jobs import Job, Row, execute

_COMMAND = f"from {__name__} import main; main()"


# As many runs as cores go on at once, and one that is alone is to be comparable with them.
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


class Running:
    """The processes of runs that go on, in whatever threads they are waited for."""

    def __init__(self) -> None:
        self._lock, self._inputs, self._stopped = threading.Lock(), set[IO[bytes]](), False

    def add(self, stdin: IO[bytes]) -> None:
        """Take in a process by its standard input, whose end interrupts it."""
        with self._lock:
            self._inputs.add(stdin)
            if self._stopped:
                stdin.close()

    def remove(self, stdin: IO[bytes]) -> None:
        """It has ended, or is to end."""
        with self._lock:
            self._inputs.discard(stdin)
            stdin.close()

    def stop(self) -> None:
        """Interrupt all of them, and those that would begin later."""
        with self._lock:
            self._stopped = True
            for stdin in self._inputs:
                stdin.close()


def execute_apart(job: Job, folder: Path, align: Alignment, rendered: Path | None, running: Running) -> Row:
    """The row of `execute`, done in another process, which ends with this one.

    Args:
        job, folder, align, rendered: As there.
        running: By which it can be interrupted from another thread.

    Raises:
        StudyError: The run failed, or its process died.
    """
    environment = os.environ | _ONE_THREAD | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", _COMMAND]
    # In a session of its own, where Ctrl-C does not reach it: this process tells it.
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, start_new_session=True
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        try:
            running.add(process.stdin)
            with suppress(BrokenPipeError, ValueError):  # it has died, or is to be interrupted
                process.stdin.write(pickle.dumps((job, folder, align, rendered)))
                process.stdin.flush()
            answer = process.stdout.read()
        finally:
            running.remove(process.stdin)
            process.wait()
    outcome = pickle.loads(answer) if answer else f"its process ended with code {process.returncode}"
    if isinstance(outcome, str):
        raise StudyError(outcome)
    row: Row = outcome
    return row


def main() -> NoReturn:
    """Do a run that comes in through the standard input, and answer with its row, or the reason why there is none."""
    answer = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what libraries print is no part of it
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        job, folder, align, rendered = pickle.load(sys.stdin.buffer)
    except EOFError:  # interrupted before it has begun
        os._exit(130)
    threading.Thread(target=_interrupt_at_the_end, daemon=True).start()
    try:
        answer.write(pickle.dumps(_outcome(job, folder, align, rendered)))
        answer.flush()
        os._exit(0)  # at once: nothing is left to be interrupted
    except KeyboardInterrupt:
        os._exit(130)


def _interrupt_at_the_end() -> None:
    """Interrupt the run when the process that waits for it has gone, or wants no row any more."""
    sys.stdin.buffer.read()
    if sys.platform == "win32":
        _thread.interrupt_main(signal.SIGTERM)
    else:  # also where it waits for something
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)


def _outcome(job: Job, folder: Path, align: Alignment, rendered: Path | None) -> Row | str:
    import cv2

    cv2.setNumThreads(1)
    try:
        return execute(job, folder, align, rendered)
    except Exception as error:  # one run that fails must not end the study
        return " ".join(str(error).split()) or type(error).__name__
