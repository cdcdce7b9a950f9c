"""A run in a process of its own: its memory is that of no other run, and where it dies, it is a row."""

from __future__ import annotations

import _thread
import os
import pickle
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import NoReturn

from fvslam_graph.core.errors import StudyError
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.study.jobs import Job, Row, execute

_COMMAND = f"from {__name__} import main; main()"


def execute_apart(job: Job, folder: Path, align: Alignment, rendered: Path | None, alone: bool) -> Row:
    """The row of `execute`, done in another process, which ends with this one.

    Args:
        job, folder, align, rendered: As there.
        alone: Whether no other run goes on, so that it may use all cores.

    Raises:
        StudyError: The run failed, or its process died.
    """
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", _COMMAND]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment) as process:
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(pickle.dumps((job, folder, align, rendered, alone)))
            process.stdin.flush()
            answer = process.stdout.read()
        finally:
            process.stdin.close()  # which interrupts a run that goes on
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
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the one that waits tells this one
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    job, folder, align, rendered, alone = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_interrupt_at_the_end, daemon=True).start()
    try:
        answer.write(pickle.dumps(_outcome(job, folder, align, rendered, alone)))
        answer.flush()
        os._exit(0)  # at once: nothing is left to be interrupted
    except KeyboardInterrupt:
        os._exit(130)


def _interrupt_at_the_end() -> None:
    """Interrupt the run when the process that waits for it has gone, or wants no row any more."""
    sys.stdin.buffer.read()
    _thread.interrupt_main(signal.SIGTERM)


def _outcome(job: Job, folder: Path, align: Alignment, rendered: Path | None, alone: bool) -> Row | str:
    import cv2

    if not alone:
        cv2.setNumThreads(1)  # as many runs as cores go on at once
    try:
        return execute(job, folder, align, rendered)
    except Exception as error:  # one run that fails must not end the study
        return " ".join(str(error).split()) or type(error).__name__
