"""The command line. Each command imports what it needs, so that `--help` is quick."""

from __future__ import annotations

import io
import logging
import os
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from typer.core import TyperCommand

from fvslam_graph import __version__
from fvslam_graph.core.choices import Mode, Preset, ScaleSource
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.evaluation.alignment import Alignment

if TYPE_CHECKING:
    from rich.console import RenderableType

    from fvslam_graph.core.config import Config
    from fvslam_graph.core.frame_result import FrameResult
    from fvslam_graph.core.sequence import Sequence
    from fvslam_graph.evaluation.tables import Table
    from fvslam_graph.evaluation.viewer import Viewer
    from fvslam_graph.study.jobs import Row
    from fvslam_graph.study.spec import Study

app = typer.Typer(
    name="fvslam",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

data_app = typer.Typer(no_args_is_help=True, help="Published recordings: which there are, and to bring them here.")
app.add_typer(data_app, name="data")

WIDE = 240  # characters of a line that is not broken
MAX_ROWS = 12  # of a table of which all columns are shown in the terminal

_T = TypeVar("_T")

SequencePath = Annotated[
    str,
    typer.Argument(
        metavar="PATH",
        help="Folder of KITTI, EuRoC, TUM, Karlsruhe or plain images, ROS bag, video, synthetic:uav, synthetic:drive.",
    ),
]
Format = Annotated[str | None, typer.Option(help="Of the recording, where it is not to be found out.")]
Frames = Annotated[str | None, typer.Option(help="Part of the sequence, START:STOP.", metavar="A:B")]
Stride = Annotated[int, typer.Option(help="Take every n-th frame.", min=1)]
ImageScale = Annotated[float, typer.Option(help="Resize the images by this factor, at most 1.")]
CameraHeight = Annotated[float | None, typer.Option(help="Metres from the camera to the ground.")]
CameraPitch = Annotated[float | None, typer.Option(help="Radians that the camera looks below the horizon.")]
GroundPlane = Annotated[
    str | None, typer.Option(help="Direction from the camera down to the ground, and metres.", metavar="'NX NY NZ D'")
]
StartPose = Annotated[
    str | None,
    typer.Option(help="Where the first image is taken, in the world of the poses.", metavar="'TX TY TZ QX QY QZ QW'"),
]
Altimeter = Annotated[Path | None, typer.Option(help="CSV of heights above the ground: stamp,height[,sigma].")]
Gnss = Annotated[
    str | None,
    typer.Option(
        help="Fixes for mode graph: CSV of stamp,latitude,longitude,altitude[,sigma]; or `recording`, those that it "
        "has; or oxts:HZ:SIGMA[:OUTLIERS[:GAP_S]], simulated from its OXTS packets or ground truth.",
        metavar="FILE",
    ),
]
GnssSigma = Annotated[float | None, typer.Option(help="Standard deviation of fixes along each axis.", metavar="METRES")]
CameraK1 = Annotated[float | None, typer.Option(help="Radial distortion left in the images; see `distortion`.")]
ImageTopic = Annotated[str | None, typer.Option("--topic", help="Image topic of a ROS bag, if it holds several.")]
Fov = Annotated[float | None, typer.Option(help="Degrees that images without calibration are wide.")]
Telemetry = Annotated[
    Path | None,
    typer.Option(
        help="What a drone recorded: .srt or flight record (.csv); found beside a video if of the same name.",
        metavar="FILE",
    ),
]
TelemetryOffset = Annotated[
    float | None,
    typer.Option(help="Added to the times of the telemetry; estimated if not given.", metavar="SECONDS"),
]
ModeName = Annotated[
    str | None, typer.Option("--mode", help=f"{', '.join(Mode)}, or a path like mypkg:MyRule.", show_default="vo")
]
Seed = Annotated[int | None, typer.Option(help="Of all random numbers.", show_default="0")]
ConfigFile = Annotated[
    Path | None,
    typer.Option(help="YAML file with settings that differ from the preset, or config.yaml of a run to repeat."),
]
PresetName = Annotated[Preset | None, typer.Option(help="Settings to start from.", show_default="tuned")]
Scale = Annotated[ScaleSource | None, typer.Option(help="Where metres come from.", show_default="plane")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", help="One setting, e.g. scale.source=map. Repeatable.", metavar="K=V")
]
Rerun = Annotated[
    str | None,
    typer.Option(help="Show it in Rerun: a file to write, or `viewer` to look at once.", metavar="FILE.rrd|viewer"),
]
Align = Annotated[Alignment, typer.Option(help="How the estimate is brought into the world of its reference.")]


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"fvslam {__version__}")
        raise typer.Exit


@app.callback()
def fvslam(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Monocular visual odometry on any recording: run it, evaluate it with evo, plot it."""


class _WithPlugins(TyperCommand):
    """A command whose help ends with what other packages add; these are looked for only when it is asked for."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        from fvslam_graph.core.plugins import Kind, names

        added = [f"{kind} {name} ({owner})" for kind in Kind for name, owner in names(kind).items()]
        self.epilog = f"Other packages add: {', '.join(added)}." if added else None
        super().format_help(ctx, formatter)


@app.command(cls=_WithPlugins)
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
    image_scale: ImageScale = 1.0,
    camera_height: CameraHeight = None,
    camera_pitch: CameraPitch = None,
    camera_k1: CameraK1 = None,
    topic: ImageTopic = None,
    fov: Fov = None,
    telemetry: Telemetry = None,
    telemetry_offset: TelemetryOffset = None,
    start_pose: StartPose = None,
    ground_plane: GroundPlane = None,
    altimeter: Altimeter = None,
    gnss: Gnss = None,
    gnss_sigma: GnssSigma = None,
    rerun: Rerun = None,
) -> None:
    """Run an estimator on a sequence and keep the result in a folder."""
    from fvslam_graph.core.files import file_name
    from fvslam_graph.sequences.open import open_sequence

    chosen = _config(preset, config, {"mode": mode, "scale.source": scale, "seed": seed}, settings)
    sequence = open_sequence(
        path,
        format=format,
        frames=frames,
        stride=stride,
        scale=image_scale,
        camera_height=camera_height,
        camera_pitch=camera_pitch,
        camera_k1=camera_k1,
        topic=topic,
        fov=fov,
        telemetry=telemetry,
        telemetry_offset=telemetry_offset,
    )
    if start_pose is not None:
        sequence = sequence.starting_at(_floats(start_pose, "--start-pose", "seven numbers, tx ty tz qx qy qz qw"))
    sequence = _with_sensors(sequence, ground_plane, altimeter, gnss, gnss_sigma, chosen.seed)
    folder = out or Path("runs") / f"{file_name(sequence.name)}-{file_name(chosen.mode)}-{chosen.preset}"
    said = _run(sequence, chosen, folder, rerun)
    judged = f"fvslam evaluate {folder}" if sequence.ground_truth is not None else f"fvslam export {folder} --to csv"
    typer.echo(f"{said}; next: {judged}; fvslam plot {folder}")


@app.command()
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
    chosen = _config(preset, config, {"mode": mode, "scale.source": scale, "seed": seed}, settings)
    source = open_live(where, camera, fov, camera_height=camera_height, camera_pitch=camera_pitch, patience=patience)
    typer.echo(f"waiting for images from {source.name}; Ctrl-C ends", err=True)
    with source, _ended_by_signals(source.stop), ExitStack() as stack:
        sequence = source.sequence
        effective = _effective(chosen, sequence)
        viewer = None if rerun is None else stack.enter_context(_viewer(rerun, sequence))

        def watch(results: Iterable[FrameResult]) -> Iterable[FrameResult]:
            printed = _printed(results, line, source.stop)
            return printed if viewer is None else viewer.watch(printed)

        run = run_live(source if viewer is None else viewer.seen(source), sequence, effective, out, watch)
        if run is not None and viewer is not None:
            viewer.end(run.smoothed)
    typer.echo(f"{source.name}: {source.summary()}", err=True)


@app.command()
def evaluate(
    estimate: Annotated[Path, typer.Argument(help="Run folder, or a TUM, KITTI or ASL file.")],
    reference: Annotated[Path | None, typer.Option(help="The same; a run knows its own ground truth.")] = None,
    align: Align = Alignment.SE3,
    time_offset: Annotated[
        float, typer.Option(help="Added to the stamps of the estimate, as evo's --t_offset.", metavar="SECONDS")
    ] = 0.0,
) -> None:
    """Compare a trajectory with a reference: APE, RPE, drift, coverage, consistency."""
    from fvslam_graph.evaluation.report import runs_table, summary_table
    from fvslam_graph.evaluation.runs import evaluation_of

    with _telling("fvslam_graph.evaluation"):
        evaluation = evaluation_of(estimate, reference, align, time_offset)
    if estimate.is_dir():
        evaluation.write(estimate)
        _show_table(runs_table([estimate]))
    _show(summary_table(evaluation))


@app.command()
def plot(
    runs: Annotated[list[Path], typer.Argument(help="Run folders.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the plots; the first run's if not given.")] = None,
    align: Align = Alignment.SE3,
    landmarks: Annotated[
        str | None,
        typer.Option(
            help="Also show the landmarks of visual SLAM in these frames of the first run, or nearest to them.",
            metavar="N,N,...",
        ),
    ] = None,
    rerun: Rerun = None,
) -> None:
    """Plot trajectories, errors, speed, scale and inliers of one or several runs, as PNG and PDF."""
    from fvslam_graph.evaluation.plots.landmarks import plot_landmarks
    from fvslam_graph.evaluation.plots.runs import plot_runs
    from fvslam_graph.runs.run_folder import read_run

    shown = plot_landmarks(runs[0], _numbers(landmarks), out or runs[0]) if landmarks is not None else []
    for file in [*plot_runs([read_run(run) for run in runs], out or runs[0], align), *shown]:
        typer.echo(file)
    if rerun is not None:
        from fvslam_graph.evaluation.viewer import show_run

        for note in show_run(read_run(runs[0]), runs[0], rerun):
            typer.echo(note, err=True)


@app.command()
def export(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    to: Annotated[str, typer.Option(help="csv, ros2, euroc, colmap, g2o, kml, gpx or geojson.", metavar="FORMAT")],
    out: Annotated[Path | None, typer.Option(help="New file or folder; beside the run's folder if not given.")] = None,
    smoothed: Annotated[bool, typer.Option("--smoothed", help="The poses by all measurements, of mode graph.")] = False,
    origin: Annotated[
        str | None,
        typer.Option(help="Where the first camera is and looks, for maps.", metavar="LAT,LON,ALT[,HEADING]"),
    ] = None,
    gnss: Annotated[
        Path | None, typer.Option(help="CSV of fixes to align with, for maps: stamp,latitude,longitude,altitude.")
    ] = None,
) -> None:
    """Write the poses of a run, with their covariances, in the format of another program."""
    from fvslam_graph.runs.export.formats import export_name, export_run
    from fvslam_graph.runs.run_folder import read_run

    exported = read_run(run)
    path = out or run.resolve().parent / export_name(exported, to, smoothed)
    form = "LAT,LON,ALT[,HEADING] in degrees and metres"
    at = None if origin is None else _floats(origin, "--origin", form)
    done = export_run(exported, to, path, smoothed, at, gnss)
    typer.echo(done.path)
    for note in done.notes:
        typer.echo(note, err=True)


@app.command(cls=_WithPlugins)
def compare(
    path: SequencePath,
    modes: Annotated[str, typer.Option(help="Comma-separated; as for run.")] = ",".join(Mode),
    seeds: Annotated[int, typer.Option(help="How many runs of each mode.", min=1)] = 5,
    topic: ImageTopic = None,
    preset: PresetName = None,
    settings: Settings = None,
    external: Annotated[
        list[str] | None,
        typer.Option(
            help="Trajectory of another system, TUM or KITTI; FILE@0.1: stamps count frames of 0.1 s. Repeatable.",
            metavar="NAME=FILE",
        ),
    ] = None,
    system: Annotated[
        list[str] | None,
        typer.Option(
            help="Another program to run: a command with {images}, {times}, {camera}, for which paths are put in, that "
            "writes a TUM file to {out}. Repeatable.",
            metavar="NAME=COMMAND",
        ),
    ] = None,
    system_limit: Annotated[
        float, typer.Option(help="After which such a program is killed.", metavar="SECONDS")
    ] = 3600.0,
    align: Align = Alignment.SIM3,
    out: Annotated[Path | None, typer.Option(help="Folder; runs/comparison-on-... if not given.")] = None,
    workers: Annotated[int, typer.Option(help="Runs at once; with 1, times are undisturbed.", min=1)] = 1,
) -> None:
    """Run all modes on a sequence over several seeds, and compare them, also with other systems."""
    from fvslam_graph.core.errors import ConfigError
    from fvslam_graph.core.yaml_files import parse_yaml
    from fvslam_graph.study.sources import Source
    from fvslam_graph.study.spec import comparison, default_folder

    files = dict(_pair(text, "--external", "NAME=FILE") for text in external or [])
    systems = dict(_pair(text, "--system", "NAME='command {images} {out}'") for text in system or [])
    values = dict(_pair(text, "--set", "group.name=value") for text in settings or [])
    study = comparison(
        Source(path=path, topic=topic),
        modes.split(","),
        seeds,
        preset=preset or Preset.TUNED,
        settings={
            name: parse_yaml(value, f"the value of '{name}={value}'", ConfigError) for name, value in values.items()
        },
        external=files,
        systems=systems,
        system_limit=system_limit,
        align=align,
    )
    _run_study(study, out or default_folder(study), workers)


@app.command(cls=_WithPlugins)
def study(
    file: Annotated[Path, typer.Argument(metavar="STUDY.yaml", help="Sequences, modes, settings, seeds.")],
    out: Annotated[Path | None, typer.Option(help="Folder; runs/<name> if not given. What it holds is kept.")] = None,
    workers: Annotated[int | None, typer.Option(help="Processes at once; one a core if not given.", min=1)] = None,
    scheduler: Annotated[str | None, typer.Option(help="Of a dask cluster to use.", metavar="tcp://HOST:PORT")] = None,
) -> None:
    """Run a grid of sequences, modes, settings and seeds in parallel, and report on it; go on where it was stopped."""
    from fvslam_graph.study.spec import default_folder, load_study

    declared = load_study(file)
    _run_study(declared, out or default_folder(declared), workers, scheduler)


@app.command()
def table(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="Folder of a study or a comparison.")],
    rows: Annotated[str, typer.Option(help="mode, sequence, preset, variant or seed.")] = "mode",
    columns: Annotated[str, typer.Option(help="The same.")] = "sequence",
    metric: Annotated[str, typer.Option(help="Column of results.csv, such as ape, ape_common, t_rel.")] = "ape_common",
    layout: Annotated[str, typer.Option("--format", help="latex, md or csv.")] = "md",
) -> None:
    """Print one number of a study as a table for a paper: best bold, second underlined, as wide as a page at most."""
    from fvslam_graph.study.metric_table import MetricTable, TableFormat

    if layout not in list(TableFormat):
        raise FvslamError(f"--format is one of {', '.join(TableFormat)}, not '{layout}'")
    typer.echo(MetricTable.of(study, rows, columns, metric).text(TableFormat(layout)), nl=False)


@app.command(cls=_WithPlugins)
def info(
    path: SequencePath,
    format: Format = None,
    camera_height: CameraHeight = None,
    camera_pitch: CameraPitch = None,
    topic: ImageTopic = None,
    fov: Fov = None,
    telemetry: Telemetry = None,
    telemetry_offset: TelemetryOffset = None,
) -> None:
    """Say what is recognised in a recording: format, frames, camera, ground truth, scale, gaps; topics of a bag."""
    from fvslam_graph.sequences.describe import describe
    from fvslam_graph.sequences.open import open_sequence, topics_of

    if topics := topics_of(path):  # also of a bag that does not open before a topic is chosen
        _show_facts([("topic", f"{known.name}: {known.count} {known.type}") for known in topics])
    sequence = open_sequence(
        path,
        format=format,
        camera_height=camera_height,
        camera_pitch=camera_pitch,
        topic=topic,
        fov=fov,
        telemetry=telemetry,
        telemetry_offset=telemetry_offset,
    )
    _show_facts(describe(sequence))


@data_app.command("list")
def list_data() -> None:
    """Say which recordings can be brought here: name, size, licence."""
    from fvslam_graph.datasets.registry import published

    _show_facts((name, f"{known.title}; {known.size}; {known.licence}") for name, known in published().items())


@data_app.command("get")
def get_data(
    name: Annotated[str, typer.Argument(help="As `fvslam data list` says.")],
    out: Annotated[Path | None, typer.Option(help="Folder; data/NAME if not given.")] = None,
) -> None:
    """Download a published recording and unpack it; stopped, it goes on from there."""
    from fvslam_graph.datasets.download import CHECKSUMS, get_dataset
    from fvslam_graph.datasets.registry import find_dataset

    dataset, folder = find_dataset(name), out or Path("data") / name
    typer.echo(f"{dataset.title}; {dataset.size}\nlicence: {dataset.licence} ({dataset.page})")
    with (
        _kept(lambda: f"what has come is kept in {folder}; the same command goes on from there"),
        _DownloadBar() as bar,
    ):
        path = get_dataset(dataset, folder, bar)
    if any(archive.sha256 is None for archive in dataset.archives):
        typer.echo(f"no checksum is published: that of this download is in {folder / CHECKSUMS}")
    typer.echo(f"next: fvslam info {path}")


@app.command()
def calibrate(
    path: Annotated[Path, typer.Argument(help="Folder of images of a board, or a video of it.")],
    square: Annotated[float, typer.Option(help="Side of the squares.", metavar="METRES")],
    checkerboard: Annotated[
        str | None, typer.Option(help="Inner corners of a checkerboard, as 9x6.", metavar="COLUMNSxROWS")
    ] = None,
    charuco: Annotated[
        str | None, typer.Option(help="Squares of a ChArUco board, as 7x5.", metavar="COLUMNSxROWS")
    ] = None,
    marker: Annotated[
        float | None, typer.Option(help="Side of the markers of a ChArUco board.", metavar="METRES")
    ] = None,
    out: Annotated[Path, typer.Option(help="Calibration to write, with a picture beside it.")] = Path("camera.yaml"),
) -> None:
    """Calibrate a camera by a board: focal lengths, principal point and distortion, with standard deviations.

    For what is left without a board, see `distortion`.
    """
    from fvslam_graph.core.errors import CameraError
    from fvslam_graph.core.extras import require
    from fvslam_graph.core.files import writing
    from fvslam_graph.evaluation.plots.calibration import plot_residuals
    from fvslam_graph.sequences import boards
    from fvslam_graph.sequences.board_calibration import calibrate as calibrated

    require("eval")  # for the picture
    if not out.name:
        raise CameraError(f"--out takes the name of a file, not '{out}'")
    picture = out.with_name(f"{out.stem}_residuals.png")
    with writing(out.parent):  # a name may be too long even to ask
        if existing := [file for file in (out, picture) if file.exists()]:
            raise CameraError(f"{existing[0]} exists and is not overwritten; give another name by --out")
    if checkerboard is not None and charuco is None and marker is None:
        board = boards.checkerboard(checkerboard, square)
    elif charuco is not None and checkerboard is None and marker is not None:
        board = boards.charuco(charuco, square, marker)
    else:
        raise CameraError("give --checkerboard, or --charuco with --marker")
    calibration = calibrated(path, *boards.find_board(path, board))
    calibration.write(out)
    plot_residuals(calibration, picture)
    for name, (value, sigma) in calibration.parameters().items():
        typer.echo(f"{name} = {value:.5g} +- {sigma:.2g}")
    typer.echo(f"{len(calibration.views)} views, {calibration.rms:.3f} pixels root mean square; {out}, {picture}")


@app.command()
def distortion(
    path: SequencePath,
    frames: Frames = None,
    stride: Stride = 1,
    camera_k1: CameraK1 = None,
    topic: ImageTopic = None,
    fov: Fov = None,
) -> None:
    """Measure the radial distortion (k1) that the calibration has left in the images, by tracks of odometry.

    It shows where the camera turns; `run --camera-k1` takes it out.
    """
    from fvslam_graph.sequences.open import open_sequence
    from fvslam_graph.vo.distortion import measure_distortion

    sequence = open_sequence(path, frames=frames, stride=stride, camera_k1=camera_k1, topic=topic, fov=fov)
    k1, sigma = measure_distortion(sequence)
    typer.echo(f"k1 = {k1:.4f} +- {sigma:.4f} (standard deviation)")


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the runs.")] = Path("runs") / "demo",
    frames: Annotated[int, typer.Option(help="Length of the flight.", min=10)] = 200,
) -> None:
    """Fly a small UAV over generated terrain, estimate its motion in all modes, and compare."""
    from fvslam_graph.core.config import load_config
    from fvslam_graph.core.extras import require
    from fvslam_graph.evaluation.plots.runs import plot_runs
    from fvslam_graph.evaluation.report import runs_table, scale_sentence
    from fvslam_graph.evaluation.runs import evaluate_run
    from fvslam_graph.runs.run_folder import read_run
    from fvslam_graph.sequences.open import open_sequence

    require("eval")
    sequence = open_sequence(f"synthetic:uav?frames={frames}")
    sequence = replace(sequence, load=cache(sequence.load))  # rendering an image takes longer than using it
    evaluations = {}
    for mode, preset in (*((mode, "tuned") for mode in Mode), (Mode.AVERAGE, "paper")):
        name = f"{mode}-{preset}"
        typer.echo(f"{name}: {_run(sequence, load_config(preset, settings=[f'mode={mode}']), out / name)}")
        evaluations[name] = evaluate_run(out / name, align=Alignment.SE3)
    folders = [out / name for name in evaluations]
    plot_runs([read_run(folder) for folder in folders], out / "plots", Alignment.SE3)
    _show_table(runs_table(folders))
    if sentence := scale_sentence(evaluations, "graph-tuned", ("vo-tuned", "vslam-tuned")):
        _show(sentence)
    typer.echo(f"plots: {out / 'plots'}")


def _config(
    preset: Preset | None, file: Path | None, options: Mapping[str, object], settings: list[str] | None
) -> Config:
    from fvslam_graph.core.config import load_config

    given = [f"{name}={value}" for name, value in options.items() if value is not None]
    return load_config(preset, file, [*given, *(settings or [])])


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


def _printed(
    results: Iterable[FrameResult], line: Callable[[FrameResult], str], stop: Callable[[], None]
) -> Iterator[FrameResult]:
    """Print a line for each result as soon as it is known; when nobody reads them any more, call `stop`."""
    for result in results:
        try:
            print(line(result), flush=True)
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left in its buffer goes there
            stop()
        yield result


def _run_study(study: Study, out: Path, workers: int | None, scheduler: str | None = None) -> None:
    from fvslam_graph.study.run import run_study
    from fvslam_graph.study.statistics import differences, verdicts

    with _kept(lambda: f"the runs that came to their end are kept in {out}; the same command goes on from there"):
        results = run_study(study, out, workers, scheduler, lambda rows, total: _told(rows, total, study.name))
    summary, failures = results.summary(), results.failures()
    _show_table(summary, whole=len(summary.rows) <= MAX_ROWS)
    for sentence in verdicts(differences(results)):
        _show(sentence)
    if failures.rows:
        _show_table(failures)
    typer.echo(f"report: {out / 'report.html'}")
    if not len(results.finished):
        raise FvslamError("no run came to its end; the table says why")


def _with_sensors(
    sequence: Sequence, plane: str | None, altimeter: Path | None, gnss: str | None, sigma: float | None, seed: int
) -> Sequence:
    """The sequence with what other sensors than the camera have measured."""
    from fvslam_graph.core.sensors import SensorKind
    from fvslam_graph.runs.gnss_file import read_fixes
    from fvslam_graph.sequences.altimeter import read_altimeter, with_altimeter
    from fvslam_graph.sequences.ground import with_ground_plane
    from fvslam_graph.simulation.gnss import SimulatedReceiver

    if plane is not None:
        sequence = with_ground_plane(sequence, _floats(plane, "--ground-plane", "four numbers, nx ny nz d"))
    if altimeter is not None:
        sequence = with_altimeter(sequence, read_altimeter(altimeter))
    if gnss is None and sigma is not None:
        raise FvslamError("--gnss-sigma is the deviation of the fixes that --gnss gives; give both")
    if gnss is None:
        return sequence
    if gnss == "recording":
        fixes = next((series for series in sequence.sensors if series.kind is SensorKind.GNSS), None)
        if fixes is None:
            raise FvslamError(f"{sequence.name} has no fixes of a GNSS receiver; give --gnss FILE")
    elif gnss.startswith("oxts:"):
        fixes = SimulatedReceiver.parse(gnss.removeprefix("oxts:")).fixes(sequence, seed)
    else:
        fixes = read_fixes(Path(gnss))
    return sequence.with_gnss(fixes, sigma)


def _run(sequence: Sequence, config: Config, folder: Path, rerun: str | None = None) -> str:
    """Run, and say how many frames came out how."""
    from fvslam_graph.core.files import one_line
    from fvslam_graph.core.trajectory import Status
    from fvslam_graph.pipeline import run_sequence

    def progress(results: Iterable[FrameResult]) -> Iterable[FrameResult]:
        return _progress(results, len(sequence), sequence.name)

    effective = _effective(config, sequence)
    with _kept(lambda: _interrupted(folder)):
        if rerun is None:
            run = run_sequence(sequence, effective, folder, progress)
        else:
            with _viewer(rerun, sequence) as viewer:
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


def _viewer(target: str, sequence: Sequence) -> Viewer:
    from fvslam_graph.evaluation.viewer import Viewer

    return Viewer(target, sequence.name, sequence.camera, sequence.ground_truth)


def _effective(config: Config, sequence: Sequence) -> Config:
    """The settings that hold for a sequence, which is run next; where that is not what was wanted, it says so."""
    import cv2

    from fvslam_graph.pipeline import resolve_config

    cv2.setNumThreads(1)  # others take a third more CPU, of which a small UAV has little, and save a tenth of the time
    effective = resolve_config(config, sequence)
    if effective != config:
        typer.echo(f"{sequence.name}: no ground is known, so the scale is relative (scale source 'map')", err=True)
    return effective


def _progress(items: Iterable[_T], total: int, label: str) -> Iterator[_T]:
    """A bar on a terminal, nothing elsewhere."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import track

    console = Console(stderr=True)
    return iter(track(items, escape(label), total, console=console, disable=not console.is_terminal, transient=True))


class _DownloadBar:
    """A bar on a terminal, nothing elsewhere; `datasets.download.Bar` says what its methods are for."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, DownloadColumn, Progress, TimeRemainingColumn

        console = Console(stderr=True)
        columns = (BarColumn(), DownloadColumn(), TimeRemainingColumn())
        self._progress = Progress(*columns, console=console, disable=not console.is_terminal, transient=True)
        self._task = self._progress.add_task("")
        self.total = 0

    def __enter__(self) -> _DownloadBar:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def update(self, count: int) -> None:
        self._progress.update(self._task, total=self.total, advance=count)

    def reset(self) -> None:
        self._progress.reset(self._task)

    def close(self) -> None:
        self._progress.refresh()


@contextmanager
def _telling(package: str) -> Iterator[None]:
    """Show what a package logs as it goes on, on a terminal."""
    from rich.console import Console
    from rich.markup import escape

    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    log = logging.getLogger(package)
    with console.status("") as status:
        handler = logging.Handler()
        handler.emit = lambda record: status.update(escape(record.getMessage()))  # type: ignore[method-assign]
        log.addHandler(handler)
        log.setLevel(logging.INFO)
        try:
            yield
        finally:
            log.removeHandler(handler)
            log.setLevel(logging.NOTSET)


def _told(rows: Iterable[tuple[int, Row]], total: int, label: str) -> Iterator[tuple[int, Row]]:
    """A bar on a terminal, and a line for each run that fails; elsewhere a line for each run."""
    from rich.console import Console
    from rich.text import Text

    from fvslam_graph.study.jobs import outcome_line

    console = Console(stderr=True)
    for done, (number, row) in enumerate(_progress(rows, total, label), 1):
        if not console.is_terminal or row["status"] != "finished":
            console.print(Text(f"{done}/{total} {outcome_line(row)}"), soft_wrap=True)
        yield number, row


@contextmanager
def _kept(what: Callable[[], str]) -> Iterator[None]:
    """Say what is kept of the block, where it is stopped."""
    try:
        yield
    except KeyboardInterrupt:
        typer.echo(f"stopped: {what()}", err=True)
        raise


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


def _show(content: RenderableType) -> None:
    """Print text or a table, no wider than the terminal; a file or a pipe counts as one of 80 characters."""
    from rich.console import Console

    Console(highlight=False, markup=False, emoji=False).print(content)


def _show_table(table: Table, whole: bool = True) -> None:
    """Print a table in as many parts as its columns need, or the first of them."""
    from rich.console import Console

    parts = table.rich(Console().width)
    for part in parts if whole else parts[:1]:
        _show(part)
    if not whole and len(parts) > 1:
        _show("The other columns are in summary.md and in the report.")
    _show(table.caption)


def _show_facts(facts: Iterable[tuple[str, str]]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None)
    for name, value in facts:
        table.add_row(name, Text(value))
    Console(width=None if sys.stdout.isatty() else WIDE).print(table)


def _pair(text: str, option: str, form: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise FvslamError(f"{option} takes {form}, not '{text}'")
    return name, value


def _floats(text: str, option: str, form: str) -> list[float]:
    try:
        return [float(number) for number in text.replace(",", " ").split()]
    except ValueError:
        raise FvslamError(f"{option} takes {form}, not '{text}'") from None


def _numbers(text: str) -> list[int]:
    try:
        return [int(number) for number in text.split(",")]
    except ValueError:
        raise FvslamError(f"--landmarks takes numbers of frames, as in 10,50, not '{text}'") from None


def main() -> None:
    """Run the command line: exit code 0, 1 with one sentence on what is wrong, 2 for wrong usage, 130 where stopped."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # what was written is kept, as by Ctrl-C
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files need not be text
    try:
        app(prog_name="fvslam")
    except FvslamError as error:
        typer.echo(f"fvslam: {' '.join(str(error).split())}", err=True)
        sys.exit(1)
    except ImportError as error:
        # Ctrl-C while a library is loaded comes as this, if it is a library in C++.
        if isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            sys.exit(130)
        raise
