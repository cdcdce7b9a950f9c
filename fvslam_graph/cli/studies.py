"""Many runs: compare modes and other systems, run a study, print its table for a paper."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fvslam_graph.cli.options import Align, ImageTopic, PresetName, SequencePath, Settings
from fvslam_graph.cli.terminal import kept, progress_bar, show, show_table
from fvslam_graph.core.choices import Mode, Preset
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.evaluation.alignment import Alignment

if TYPE_CHECKING:
    from fvslam_graph.study.jobs import Row
    from fvslam_graph.study.spec import Study

MAX_ROWS = 12  # of a table of which all columns are shown in the terminal


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


def _run_study(study: Study, out: Path, workers: int | None, scheduler: str | None = None) -> None:
    from fvslam_graph.study.run import run_study
    from fvslam_graph.study.statistics import differences, verdicts

    with kept(lambda: f"the runs that came to their end are kept in {out}; the same command goes on from there"):
        results = run_study(study, out, workers, scheduler, lambda rows, total: _told(rows, total, study.name))
    summary, failures = results.summary(), results.failures()
    show_table(summary, whole=len(summary.rows) <= MAX_ROWS)
    for sentence in verdicts(differences(results)):
        show(sentence)
    if failures.rows:
        show_table(failures)
    typer.echo(f"report: {out / 'report.html'}")
    if not len(results.finished):
        raise FvslamError("no run came to its end; the table says why")


def _told(rows: Iterable[tuple[int, Row]], total: int, label: str) -> Iterator[tuple[int, Row]]:
    """A bar on a terminal, and a line for each run that fails; elsewhere a line for each run."""
    from rich.console import Console
    from rich.text import Text

    from fvslam_graph.study.jobs import outcome_line

    console = Console(stderr=True)
    for done, (number, row) in enumerate(progress_bar(rows, total, label), 1):
        if not console.is_terminal or row["status"] != "finished":
            console.print(Text(f"{done}/{total} {outcome_line(row)}"), soft_wrap=True)
        yield number, row


def _pair(text: str, option: str, form: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise FvslamError(f"{option} takes {form}, not '{text}'")
    return name, value
