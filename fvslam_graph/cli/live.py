"""Estimate the motion of a camera while it takes images."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from fvslam_graph.cli.options import (
    CameraHeight,
    CameraPitch,
    ConfigFile,
    ModeName,
    PresetName,
    Rerun,
    Scale,
    Seed,
    Settings,
    chosen_config,
)
from fvslam_graph.cli.run import effective_config, open_viewer

if TYPE_CHECKING:
    from fvslam_graph.core.frame_result import FrameResult


def live(
    where: Annotated[
        str,
        typer.Argument(
            metavar="CAMERA",
            help="Number of a camera, address of a stream (rtsp://...), or a folder that images come to.",
        ),
    ],
    camera: Annotated[
        Path | None, typer.Option(help="Its calibration; camera.yaml in the folder if not given.", metavar="FILE")
    ] = None,
    fov: Annotated[
        float | None, typer.Option(help="Degrees that its images are wide, in place of a calibration.")
    ] = None,
    format: Annotated[str, typer.Option(help="tum, or json with covariance and status.")] = "tum",
    out: Annotated[Path | None, typer.Option(help="Folder of the run; without it, none is written.")] = None,
    patience: Annotated[
        float | None, typer.Option(help="End when no image has come for so long.", metavar="SECONDS")
    ] = None,
    mode: ModeName = None,
    preset: PresetName = None,
    config: ConfigFile = None,
    scale: Scale = None,
    settings: Settings = None,
    seed: Seed = None,
    camera_height: CameraHeight = None,
    camera_pitch: CameraPitch = None,
    rerun: Rerun = None,
) -> None:
    """Estimate the motion of a camera while it takes images, a line for each pose; Ctrl-C ends it.

    Where images come faster than they are used, the newest is taken and the others are dropped.
    """
    from fvslam_graph.pipeline import run_live
    from fvslam_graph.runs.pose_lines import pose_line
    from fvslam_graph.sequences.live import open_live

    line = pose_line(format)
    chosen = chosen_config(preset, config, {"mode": mode, "scale.source": scale, "seed": seed}, settings)
    source = open_live(where, camera, fov, camera_height=camera_height, camera_pitch=camera_pitch, patience=patience)
    typer.echo(f"waiting for images from {source.name}; Ctrl-C ends", err=True)
    with source, _ended_by_signals(source.stop), _poses_alone() as lines, ExitStack() as stack:
        sequence = source.sequence
        effective = effective_config(chosen, sequence)
        viewer = None if rerun is None else stack.enter_context(open_viewer(rerun, sequence))

        def watch(results: Iterable[FrameResult]) -> Iterable[FrameResult]:
            printed = _printed(results, line, lines, source.stop)
            return printed if viewer is None else viewer.watch(printed)

        run = run_live(source if viewer is None else viewer.seen(source), sequence, effective, out, watch)
        if run is not None and viewer is not None:
            viewer.end(run.smoothed)
    typer.echo(f"{source.name}: {source.summary()}", err=True)


@contextmanager
def _ended_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Ctrl-C and SIGTERM call `stop` within the block; the second one interrupts."""
    numbers = (signal.SIGINT, signal.SIGTERM)

    def end(*_: object) -> None:
        for number in numbers:
            signal.signal(number, signal.default_int_handler)
        stop()

    before = {number: signal.signal(number, end) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _poses_alone() -> Iterator[TextIO]:
    """Keep the standard output for poses alone within the block: what libraries print there goes to the other one."""
    try:
        number, other = sys.stdout.fileno(), sys.stderr.fileno()
    except OSError:  # of a test, which has no files behind them
        yield sys.stdout
        return
    with os.fdopen(os.dup(number), "w") as lines:
        os.dup2(other, number)
        try:
            yield lines
        finally:
            os.dup2(lines.fileno(), number)


def _printed(
    results: Iterable[FrameResult], line: Callable[[FrameResult], str], lines: TextIO, stop: Callable[[], None]
) -> Iterator[FrameResult]:
    """Write a line for each result as soon as it is known; when nobody reads them any more, call `stop`."""
    for result in results:
        try:
            print(line(result), file=lines, flush=True)
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), lines.fileno())  # what is left in its buffer goes there
            stop()
        yield result
