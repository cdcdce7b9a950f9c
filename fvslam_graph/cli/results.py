"""What is done with a run: evaluate it, plot it, export it."""

from pathlib import Path
from typing import Annotated

import typer

from fvslam_graph.cli.options import Align, Rerun, floats
from fvslam_graph.cli.terminal import show, show_table, telling
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.evaluation.alignment import Alignment


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

    with telling("fvslam_graph.evaluation"):
        evaluation = evaluation_of(estimate, reference, align, time_offset)
    if estimate.is_dir():
        evaluation.write(estimate)
        show_table(runs_table([estimate]))
    show(summary_table(evaluation))


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
        from fvslam_graph.evaluation.replay import show_run

        for note in show_run(read_run(runs[0]), runs[0], rerun):
            typer.echo(note, err=True)


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
    at = None if origin is None else floats(origin, "--origin", form)
    done = export_run(exported, to, path, smoothed, at, gnss)
    typer.echo(done.path)
    for note in done.notes:
        typer.echo(note, err=True)


def _numbers(text: str) -> list[int]:
    try:
        return [int(number) for number in text.split(",")]
    except ValueError:
        raise FvslamError(f"--landmarks takes numbers of frames, as in 10,50, not '{text}'") from None
