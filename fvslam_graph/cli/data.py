"""Published recordings: list them, bring one here."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fvslam_graph.cli.terminal import kept, show_facts

data_app = typer.Typer(no_args_is_help=True, help="Published recordings: which there are, and to bring them here.")


@data_app.command("list")
def list_data() -> None:
    """Say which recordings can be brought here: name, size, licence."""
    from fvslam_graph.datasets.registry import published

    show_facts((name, f"{known.title}; {known.size}; {known.licence}") for name, known in published().items())


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
        kept(lambda: f"what has come is kept in {folder}; the same command goes on from there"),
        _DownloadBar() as bar,
    ):
        path = get_dataset(dataset, folder, bar)
    if any(archive.sha256 is None for archive in dataset.archives):
        typer.echo(f"no checksum is published: that of this download is in {folder / CHECKSUMS}")
    typer.echo(f"next: fvslam info {path}")


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
