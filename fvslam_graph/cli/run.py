"""Run an estimator on a sequence, into a folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fvslam_graph.cli.options import (
    CameraHeight,
    CameraPitch,
    ConfigFile,
    Format,
    Fov,
    Frames,
    ImageTopic,
    ModeName,
    PresetName,
    Recalibration,
    Rerun,
    Scale,
    Seed,
    SequencePath,
    Settings,
    Stride,
    Telemetry,
    TelemetryOffset,
    chosen_config,
    floats,
)
from fvslam_graph.cli.sensors import Altimeter, Gnss, GnssSigma, GroundPlane, with_sensors
from fvslam_graph.cli.terminal import kept, progress_bar
from fvslam_graph.core.errors import FvslamError

if TYPE_CHECKING:
    from fvslam_graph.core.config import Config
    from fvslam_graph.core.frame_result import FrameResult
    from fvslam_graph.core.sequence import Sequence
    from fvslam_graph.evaluation.viewer import Viewer


def run(
    path: SequencePath,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the run; runs/<sequence>-<mode>-<preset> if not given.")
    ] = None,
    mode: ModeName = None,
    preset: PresetName = None,
    config: ConfigFile = None,
    scale: Scale = None,
    settings: Settings = None,
    seed: Seed = None,
    format: Format = None,
    frames: Frames = None,
    stride: Stride = 1,
    image_scale: Annotated[float, typer.Option(help="Resize the images by this factor, at most 1.")] = 1.0,
    camera_height: CameraHeight = None,
    camera_pitch: CameraPitch = None,
    recalibration: Recalibration = None,
    topic: ImageTopic = None,
    fov: Fov = None,
    telemetry: Telemetry = None,
    telemetry_offset: TelemetryOffset = None,
    start_pose: Annotated[
        str | None,
        typer.Option(
            help="Where the first image is taken, in the world of the poses.", metavar="'TX TY TZ QX QY QZ QW'"
        ),
    ] = None,
    ground_plane: GroundPlane = None,
    altimeter: Altimeter = None,
    gnss: Gnss = None,
    gnss_sigma: GnssSigma = None,
    rerun: Rerun = None,
) -> None:
    """Run an estimator on a sequence and keep the result in a folder."""
    from fvslam_graph.core.files import file_name
    from fvslam_graph.sequences.open import open_sequence

    chosen = chosen_config(preset, config, {"mode": mode, "scale.source": scale, "seed": seed}, settings)
    sequence = open_sequence(
        path,
        format=format,
        frames=frames,
        stride=stride,
        scale=image_scale,
        camera_height=camera_height,
        camera_pitch=camera_pitch,
        recalibration=recalibration,
        topic=topic,
        fov=fov,
        telemetry=telemetry,
        telemetry_offset=telemetry_offset,
    )
    if start_pose is not None:
        sequence = sequence.starting_at(floats(start_pose, "--start-pose", "seven numbers, tx ty tz qx qy qz qw"))
    sequence = with_sensors(sequence, ground_plane, altimeter, gnss, gnss_sigma, chosen.seed)
    folder = out or Path("runs") / f"{file_name(sequence.name)}-{file_name(chosen.mode)}-{chosen.preset}"
    said = run_into_folder(sequence, chosen, folder, rerun)
    judged = f"fvslam evaluate {folder}" if sequence.ground_truth is not None else f"fvslam export {folder} --to csv"
    typer.echo(f"{said}; next: {judged}; fvslam plot {folder}")


def run_into_folder(sequence: Sequence, config: Config, folder: Path, rerun: str | None = None) -> str:
    """Run, and say how many frames came out how."""
    from fvslam_graph.core.files import one_line
    from fvslam_graph.core.trajectory import Status
    from fvslam_graph.pipeline import run_sequence

    def progress(results: Iterable[FrameResult]) -> Iterable[FrameResult]:
        return progress_bar(results, len(sequence), sequence.name)

    effective = effective_config(config, sequence)
    with kept(lambda: _interrupted(folder)):
        if rerun is None:
            run = run_sequence(sequence, effective, folder, progress)
        else:
            with open_viewer(rerun, sequence) as viewer:
                watched = viewer.watched(sequence)
                run = run_sequence(watched, effective, folder, lambda results: viewer.watch(progress(results)))
                viewer.end(run.smoothed)
    statuses = Counter(run.frames["status"].tolist())
    counts = ", ".join(f"{statuses[status]} {status}" for status in Status if statuses[status])
    if 2 * (statuses[Status.TRACKED] + statuses[Status.STATIC]) < len(sequence):
        typer.echo(
            f"{sequence.name}: most frames were not tracked ({counts}), their poses are guesses; "
            "`fvslam info` says what is read of the recording",
            err=True,
        )
    if sequence.gnss is not None and run.info.get("placement") is None:
        typer.echo(
            f"{sequence.name}: the fixes of {sequence.gnss.source} do not tell where on Earth it is; they are too few, "
            "the path is too short against their deviations, most of them contradict it, or their clock is another",
            err=True,
        )
    return one_line(f"{len(sequence)} frames of {sequence.name}: {counts}")


def effective_config(config: Config, sequence: Sequence) -> Config:
    """The settings that hold for a sequence, which is run next; where that is not what was wanted, it says so."""
    import cv2

    from fvslam_graph.pipeline import resolve_config

    cv2.setNumThreads(1)  # others take a third more CPU, of which a small UAV has little, and save a tenth of the time
    effective = resolve_config(config, sequence)
    if effective != config:
        typer.echo(f"{sequence.name}: no ground is known, so the scale is relative (scale source 'map')", err=True)
    return effective


def open_viewer(target: str, sequence: Sequence) -> Viewer:
    """Begin to show a sequence in Rerun, as `--rerun` asks for."""
    from fvslam_graph.evaluation.viewer import Viewer

    return Viewer(target, sequence.name, sequence.camera, sequence.ground_truth)


def _interrupted(folder: Path) -> str:
    """What an interrupted run has left, and what can be done with it."""
    from fvslam_graph.runs.run_folder import UNFINISHED, read_run

    for place in (folder / UNFINISHED, folder):
        with suppress(FvslamError):
            run = read_run(place)
            if run.info["status"] == "interrupted":
                count = f"{len(run.online)} of {run.info.get('frames')} frames"
                return f"{count} are kept in {place}, which evaluate and plot take; the same command begins anew"
    return "nothing was estimated yet"
