"""Many runs, one after another or in parallel, each a process; each is kept when it ends, and none is done twice."""

from __future__ import annotations

import logging
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from fvslam_graph.core.errors import FvslamError, StudyError
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.runs.ownership import FolderKind, claimed, disown
from fvslam_graph.study.jobs import Job, Row, cached_row, execute
from fvslam_graph.study.process import Running, execute_apart
from fvslam_graph.study.sources import HeldSequence, Source, render

if TYPE_CHECKING:
    from distributed import Client

SCHEDULER_TIMEOUT = "20s"  # with a scheduler that may not be there

_log = logging.getLogger(__name__)


def execute_all(
    jobs: Sequence[Job],
    runs: Path,
    align: Alignment = Alignment.SIM3,
    workers: int | None = None,
    scheduler: str | None = None,
) -> Iterator[tuple[int, Row]]:
    """Which job, and its row, as each ends; first those that were done before.

    A run that fails is a row, too: its column `status` says why.

    Args:
        jobs: In the order in which they are begun.
        runs: Folder of their folders; with a scheduler, on a file system that its workers see under the same path.
        align: For the evaluation.
        workers: Runs at once, by default one a core. With 1, one run after another, whose times are undisturbed.
        scheduler: Address of a running dask scheduler to use instead, such as tcp://HOST:8786.

    Raises:
        StudyError: The scheduler does not answer.
    """
    pending: dict[int, Path] = {}
    for number, job in enumerate(jobs):
        try:
            folder = job.folder(runs)
        except FvslamError as error:
            yield number, _failed(job, error)
            continue
        row = cached_row(folder, align) if job.is_reproducible else None
        if row is None:
            pending[number] = folder
        else:
            yield number, row
    images = runs / "rendered"
    held = {number: reason for number in pending if (reason := _bound_to_this_process(jobs[number])) is not None}
    for reason in dict.fromkeys(held.values()):
        _log.warning(reason)
    sent = {number: folder for number, folder in pending.items() if number not in held}
    workers = min(workers or os.cpu_count() or 1, len(sent))
    if sent and scheduler is not None:
        yield from _distributed(jobs, sent, align, images, scheduler)
        pending = {number: pending[number] for number in held}
    elif workers > 1:
        yield from _side_by_side(jobs, sent, align, images, workers)
        pending = {number: pending[number] for number in held}
    if pending:
        yield from _one_by_one(jobs, pending, align, images)


def _bound_to_this_process(job: Job) -> str | None:
    """Why no other process can do it; None where one can."""
    mode = job.config.mode
    if not job.is_reproducible:
        return f"{mode} cannot be imported by its name: it runs in this process, and each time anew"
    if mode.startswith("__main__:"):
        return f"{mode} is in a script, which other processes do not import: it runs in this process"
    if not job.source.can_be_sent:
        return f"{job.source.label} is too large to be written for other processes: it is run in this process"
    return None


def _one_by_one(
    jobs: Sequence[Job], pending: Mapping[int, Path], align: Alignment, images: Path
) -> Iterator[tuple[int, Row]]:
    """One after another."""
    with _kept_for_now(images):
        rendered: dict[Source, Path | None] = {}
        for number, folder in pending.items():
            source = jobs[number].source
            if source not in rendered:
                rendered[source] = None
                with suppress(FvslamError):  # its runs say why
                    rendered[source] = render(source, images)
            yield number, _attempt(jobs[number], folder, align, rendered[source], Running())


def _side_by_side(
    jobs: Sequence[Job], pending: Mapping[int, Path], align: Alignment, images: Path, workers: int
) -> Iterator[tuple[int, Row]]:
    """Run up to `workers` processes at once, each waited for by a thread."""
    running = Running()
    with _kept_for_now(images), ThreadPoolExecutor(workers) as pool:
        rendered: dict[Source, Future[Path | None]] = {}
        numbers: dict[Future[Row], int] = {}

        def attempt(job: Job, folder: Path) -> Row:
            with suppress(FvslamError):  # its run says why
                return _attempt(job, folder, align, rendered[job.source].result(), running)
            return _attempt(job, folder, align, None, running)

        try:
            for number, folder in pending.items():
                job = jobs[number]
                if job.source not in rendered:  # begun before the first of its runs, which wait for it
                    rendered[job.source] = pool.submit(render, job.source, images)
                numbers[pool.submit(attempt, job, folder)] = number
            for future in as_completed(numbers):
                yield numbers[future], future.result()
        finally:  # also where nobody wants more of them
            pool.shutdown(wait=False, cancel_futures=True)
            running.stop()


def _distributed(
    jobs: Sequence[Job], pending: Mapping[int, Path], align: Alignment, images: Path, scheduler: str
) -> Iterator[tuple[int, Row]]:
    """Run on the workers of a dask cluster that exists."""
    import distributed

    with _connected(scheduler) as client, _kept_for_now(images):
        sources = dict.fromkeys(jobs[number].source for number in pending)
        rendered = {
            source: render(source, images.absolute())
            if isinstance(source, HeldSequence)
            else client.submit(render, source, images.absolute(), pure=False)
            for source in sources
        }
        # In the order of the jobs, so that a worker stays with a recording that it has opened.
        numbers = {
            client.submit(
                _on_worker,
                _light(jobs[number]),
                folder.absolute(),
                align,
                rendered[jobs[number].source],
                key=folder.name,
                priority=-number,
            ): number
            for number, folder in pending.items()
        }
        for future in distributed.as_completed(numbers):
            number, error = numbers[future], future.exception()  # of a worker that died, above all
            yield number, future.result() if error is None else _failed(jobs[number], error)


def _light(job: Job) -> Job:
    """What is sent of a job to another process: images in memory are in a file by then."""
    return replace(job, source=job.source.without_images()) if isinstance(job.source, HeldSequence) else job


def _connected(scheduler: str) -> Client:
    from distributed import Client

    try:
        if not scheduler:  # which would begin a cluster
            raise ValueError("it is no address")
        return Client(scheduler, timeout=SCHEDULER_TIMEOUT)
    except Exception as error:  # as which an address comes back that is none depends on what it is like
        reason = " ".join(str(error).split()) or type(error).__name__
        raise StudyError(
            f"no dask scheduler answers at '{scheduler}'; start one and give its address, such as tcp://HOST:8786, or "
            f"leave it out ({reason})"
        ) from None


@contextmanager
def _kept_for_now(images: Path) -> Iterator[None]:
    """Rendered images are kept no longer than they are needed; those of a study that was killed are in the way."""
    with claimed(images, FolderKind.IMAGES):
        try:
            _remove_images(images)
            yield
        finally:
            with suppress(OSError):
                _remove_images(images)
                disown(images)


def _remove_images(folder: Path) -> None:
    for file in folder.glob("*.npz"):
        file.unlink()


def _on_worker(job: Job, folder: Path, align: Alignment, rendered: Path | None) -> Row:
    """Refuse another recording or version of the code, which this worker, perhaps on another machine, may have."""
    try:
        if not isinstance(job.source, HeldSequence) and job.folder(folder.parent).name != folder.name:
            raise StudyError(f"on {platform.node()}, the recording, this package or a library of it is another one")
    except FvslamError as error:
        return _failed(job, error)
    return _attempt(job, folder, align, rendered, Running())


def _attempt(job: Job, folder: Path, align: Alignment, rendered: Path | None, running: Running) -> Row:
    try:
        written = rendered is not None or not isinstance(job.source, HeldSequence)
        if written and _bound_to_this_process(job) is None:
            return execute_apart(_light(job), folder, align, rendered, running)
        return execute(job, folder, align, rendered)
    except Exception as error:  # one run that fails must not end the study
        return _failed(job, error)


def _failed(job: Job, error: BaseException) -> Row:
    reason = " ".join(str(error).split()) or type(error).__name__
    return job.labels() | {"status": f"failed: {reason}"}
