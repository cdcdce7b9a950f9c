"""The command line. Each command imports what it needs, so that `--help` is quick."""

from __future__ import annotations

import io
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from fvslam_graph.core.errors import FvslamError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from fvslam_graph.core.config import Config
    from fvslam_graph.core.sequence import Sequence
    from fvslam_graph.evaluation.tables import Table
    from fvslam_graph.study.jobs import Row
    from fvslam_graph.study.spec import Study

app = typer.Typer(
    name="fvslam",
    help="Monocular visual odometry on any recording: run it, evaluate it with evo, plot it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

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
Frames = Annotated[str | None, typer.Option(help="Part of the sequence, START:STOP.", metavar="A:B")]
Stride = Annotated[int, typer.Option(help="Take every n-th frame.", min=1)]
ImageScale = Annotated[float, typer.Option(help="Resize the images by this factor, at most 1.")]
CameraHeight = Annotated[float | None, typer.Option(help="Metres from the camera to the ground.")]
CameraPitch = Annotated[float | None, typer.Option(help="Radians that the camera looks below the horizon.")]
CameraK1 = Annotated[float | None, typer.Option(help="Radial distortion left in the images; see `distortion`.")]
ImageTopic = Annotated[str | None, typer.Option("--topic", help="Image topic of a ROS bag, if it holds several.")]
Preset = Annotated[str | None, typer.Option(help="paper or tuned.", show_default="tuned")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", help="One setting, e.g. scale.source=map. Repeatable.", metavar="K=V")
]
Align = Annotated[str, typer.Option(help="none, origin, se3 or sim3.")]


@app.command()
def run(
    path: SequencePath,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the run; runs/<sequence>-<mode>-<preset> if not given.")
    ] = None,
    mode: Annotated[
        str | None, typer.Option(help="vo, vslam, average, intersection or graph.", show_default="vo")
    ] = None,
    preset: Preset = None,
    config: Annotated[
        Path | None,
        typer.Option(help="YAML file with settings that differ from the preset, or config.yaml of a run to repeat."),
    ] = None,
    settings: Settings = None,
    seed: Annotated[int | None, typer.Option(help="Of all random numbers.", show_default="0")] = None,
    frames: Frames = None,
    stride: Stride = 1,
    image_scale: ImageScale = 1.0,
    camera_height: CameraHeight = None,
    camera_pitch: CameraPitch = None,
    camera_k1: CameraK1 = None,
    topic: ImageTopic = None,
) -> None:
    """Run an estimator on a sequence and keep the result in a folder."""
    from fvslam_graph.core.config import load_config
    from fvslam_graph.core.files import file_name
    from fvslam_graph.sequences.open import open_sequence

    given = [f"{name}={value}" for name, value in (("mode", mode), ("seed", seed)) if value is not None]
    chosen = load_config(preset, config, [*given, *(settings or [])])
    sequence = open_sequence(
        path,
        frames=frames,
        stride=stride,
        scale=image_scale,
        camera_height=camera_height,
        camera_pitch=camera_pitch,
        camera_k1=camera_k1,
        topic=topic,
    )
    folder = out or Path("runs") / f"{file_name(sequence.name)}-{chosen.mode}-{chosen.preset}"
    said = _run(sequence, chosen, folder)
    typer.echo(f"{said}; next: fvslam evaluate {folder}; fvslam plot {folder}")


@app.command()
def evaluate(
    estimate: Annotated[Path, typer.Argument(help="Run folder, or a TUM, KITTI or ASL file.")],
    reference: Annotated[Path | None, typer.Option(help="The same; a run knows its own ground truth.")] = None,
    align: Align = "se3",
    time_offset: Annotated[
        float, typer.Option(help="Added to the stamps of the estimate, as evo's --t_offset.", metavar="SECONDS")
    ] = 0.0,
) -> None:
    """Compare a trajectory with a reference: APE, RPE, drift, coverage, consistency."""
    from fvslam_graph.evaluation.report import runs_table, summary_table
    from fvslam_graph.evaluation.runs import evaluation_of

    evaluation = evaluation_of(estimate, reference, align, time_offset)
    if estimate.is_dir():
        evaluation.write(estimate)
        _show_table(runs_table([estimate]))
    _show(summary_table(evaluation))


@app.command()
def plot(
    runs: Annotated[list[Path], typer.Argument(help="Run folders.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the plots; the first run's if not given.")] = None,
    align: Align = "se3",
    landmarks: Annotated[
        str | None,
        typer.Option(
            help="Also show the landmarks of visual SLAM in these frames of the first run, or nearest to them.",
            metavar="N,N,...",
        ),
    ] = None,
) -> None:
    """Plot trajectories, errors, speed, scale and inliers of one or several runs, as PNG and PDF."""
    from fvslam_graph.evaluation.alignment import Alignment
    from fvslam_graph.evaluation.plots.landmarks import plot_landmarks
    from fvslam_graph.evaluation.plots.runs import plot_runs
    from fvslam_graph.runs.run_folder import read_run

    shown = plot_landmarks(runs[0], _numbers(landmarks), out or runs[0]) if landmarks is not None else []
    for file in [*plot_runs([read_run(run) for run in runs], out or runs[0], Alignment.named(align)), *shown]:
        typer.echo(file)


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
    done = export_run(exported, to, path, smoothed, None if origin is None else _origin(origin), gnss)
    typer.echo(done.path)
    for note in done.notes:
        typer.echo(note, err=True)


@app.command()
def compare(
    path: SequencePath,
    modes: Annotated[str, typer.Option(help="Comma-separated.")] = "vo,vslam,average,intersection,graph",
    seeds: Annotated[int, typer.Option(help="How many runs of each mode.", min=1)] = 5,
    topic: ImageTopic = None,
    preset: Preset = None,
    settings: Settings = None,
    external: Annotated[
        list[str] | None,
        typer.Option(
            help="Trajectory of another system, TUM or KITTI; FILE@0.1: stamps count frames of 0.1 s. Repeatable.",
            metavar="NAME=FILE",
        ),
    ] = None,
    align: Align = "sim3",
    out: Annotated[Path | None, typer.Option(help="Folder; runs/comparison-on-... if not given.")] = None,
    workers: Annotated[int, typer.Option(help="Runs at once; with 1, times are undisturbed.", min=1)] = 1,
) -> None:
    """Run all modes on a sequence over several seeds, and compare them, also with other systems."""
    from fvslam_graph.core.errors import ConfigError
    from fvslam_graph.core.yaml_files import parse_yaml
    from fvslam_graph.study.jobs import Source
    from fvslam_graph.study.spec import comparison, default_folder

    files = dict(_pair(text, "--external", "NAME=FILE") for text in external or [])
    values = dict(_pair(text, "--set", "group.name=value") for text in settings or [])
    study = comparison(
        Source(path=path, topic=topic),
        modes.split(","),
        seeds,
        preset or "tuned",
        {name: parse_yaml(value, f"the value of '{name}={value}'", ConfigError) for name, value in values.items()},
        files,
        align,
    )
    _run_study(study, out or default_folder(study), workers)


@app.command()
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
def info(
    path: SequencePath,
    camera_height: CameraHeight = None,
    camera_pitch: CameraPitch = None,
    topic: ImageTopic = None,
) -> None:
    """Say what is recognised in a recording: format, frames, camera, ground truth, scale, gaps; topics of a bag."""
    from fvslam_graph.sequences.describe import describe
    from fvslam_graph.sequences.open import open_sequence, topics_of

    if topics := topics_of(path):  # also of a bag that does not open before a topic is chosen
        _show_facts([("topic", f"{known.name}: {known.count} {known.type}") for known in topics])
    sequence = open_sequence(path, camera_height=camera_height, camera_pitch=camera_pitch, topic=topic)
    _show_facts(describe(sequence))


@app.command()
def distortion(
    path: SequencePath,
    frames: Frames = None,
    stride: Stride = 1,
    camera_k1: CameraK1 = None,
    topic: ImageTopic = None,
) -> None:
    """Measure the radial distortion (k1) that the calibration has left in the images, by tracks of odometry.

    It shows where the camera turns; `run --camera-k1` takes it out.
    """
    from fvslam_graph.sequences.open import open_sequence
    from fvslam_graph.vo.distortion import measure_distortion

    sequence = open_sequence(path, frames=frames, stride=stride, camera_k1=camera_k1, topic=topic)
    k1, sigma = measure_distortion(sequence)
    typer.echo(f"k1 = {k1:.4f} +- {sigma:.4f} (standard deviation)")


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the runs.")] = Path("runs") / "demo",
    frames: Annotated[int, typer.Option(help="Length of the flight.", min=10)] = 200,
) -> None:
    """Fly a small UAV over generated terrain, estimate its motion in all modes, and compare."""
    from fvslam_graph.core.config import Mode, load_config
    from fvslam_graph.evaluation.alignment import Alignment
    from fvslam_graph.evaluation.plots.runs import plot_runs
    from fvslam_graph.evaluation.report import runs_table, scale_sentence
    from fvslam_graph.evaluation.runs import evaluate_run
    from fvslam_graph.runs.run_folder import read_run
    from fvslam_graph.sequences.open import open_sequence

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


def _run(sequence: Sequence, config: Config, folder: Path) -> str:
    """Run, and say how many frames came out how."""
    from fvslam_graph.core.files import one_line
    from fvslam_graph.core.trajectory import Status
    from fvslam_graph.pipeline import resolve_config, run_sequence

    effective = resolve_config(config, sequence)
    if effective != config:
        typer.echo(f"{sequence.name}: no ground is known, so the scale is relative (scale source 'map')", err=True)
    count, name = len(sequence), sequence.name
    with _kept(lambda: _interrupted(folder)):
        run = run_sequence(sequence, effective, folder, lambda results: _progress(results, count, name))
    statuses = Counter(run.frames["status"].tolist())
    counts = ", ".join(f"{statuses[status]} {status}" for status in Status if statuses[status])
    if 2 * (statuses[Status.TRACKED] + statuses[Status.STATIC]) < len(sequence):
        typer.echo(
            f"{sequence.name}: most frames were not tracked ({counts}), their poses are guesses; "
            "`fvslam info` says what is read of the recording",
            err=True,
        )
    return one_line(f"{len(sequence)} frames of {sequence.name}: {counts}")


def _progress(items: Iterable[_T], total: int, label: str) -> Iterator[_T]:
    """A bar on a terminal, nothing elsewhere."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import track

    console = Console(stderr=True)
    return iter(track(items, escape(label), total, console=console, disable=not console.is_terminal, transient=True))


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
    """Where the block is stopped, say what is kept of it."""
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


def _numbers(text: str) -> list[int]:
    try:
        return [int(number) for number in text.split(",")]
    except ValueError:
        raise FvslamError(f"--landmarks takes numbers of frames, as in 10,50, not '{text}'") from None


def _origin(text: str) -> list[float]:
    try:
        return [float(number) for number in text.split(",")]
    except ValueError:
        raise FvslamError(f"--origin takes LAT,LON,ALT[,HEADING] in degrees and metres, not '{text}'") from None


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
