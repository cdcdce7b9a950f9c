"""The command line. Each command imports what it needs, so that `--help` is quick.

For the same reason, modules that need no postponed annotations do without: typer evaluates those of all commands.
"""

import io
import signal
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from fvslam_graph import __version__
from fvslam_graph.cli import data, demo, live, recordings, results, run, studies
from fvslam_graph.core.errors import FvslamError

app = typer.Typer(
    name="fvslam",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


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


# In the order of `fvslam --help`.
app.command(cls=_WithPlugins)(run.run)
app.command()(live.live)
app.command()(results.evaluate)
app.command()(results.plot)
app.command()(results.export)
app.command(cls=_WithPlugins)(studies.compare)
app.command(cls=_WithPlugins)(studies.study)
app.command()(studies.table)
app.command(cls=_WithPlugins)(recordings.info)
app.command()(recordings.calibrate)
app.command()(demo.demo)
app.add_typer(data.data_app, name="data")


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
