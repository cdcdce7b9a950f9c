"""Install the wheel into fresh environments, without extras and with each: size, start, and what the demo says.

    make installs

At last, what the core needs on 64-bit ARM is resolved, from wheels alone.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import venv
from email.parser import Parser
from pathlib import Path
from typing import Annotated
from zipfile import ZipFile

import typer
from one_sentence import one_sentence
from packaging.requirements import Requirement
from pages import save_table

from fvslam_graph.evaluation.tables import Table

IMPORT = "import time, fvslam_graph.pipeline; print(time.process_time())"
DEMO_FRAMES = 10
ARM = {"platform_machine": "aarch64", "extra": ""}
ARM_TAGS = ("manylinux_2_28_aarch64", "manylinux_2_27_aarch64", "manylinux2014_aarch64")


def main(
    wheel: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="Of this package.")],
    out: Annotated[Path, typer.Option(help="Folder for the table.")] = Path("runs") / "installs",
) -> None:
    """Make a table of all installs, then say whether the core resolves on ARM."""
    metadata = Parser().parsestr(_metadata(wheel))
    rows = []
    for extra in ("", *metadata.get_all("Provides-Extra", [])):
        with tempfile.TemporaryDirectory() as folder:
            cells = _installed(f"{wheel.resolve()}{extra and f'[{extra}]'}", Path(folder))
            rows.append([extra or "none", *cells])
    save_table(out, "installs", Table(("extra", f"demo of {DEMO_FRAMES} frames", "MB", "import (s)"), rows, words=2))
    needed = [Requirement(line) for line in metadata.get_all("Requires-Dist", [])]
    core = [f"{one.name}{one.specifier}" for one in needed if one.marker is None or one.marker.evaluate(ARM)]
    typer.echo(f"64-bit ARM: {_resolved_on_arm(core)}")


def _metadata(wheel: Path) -> str:
    with ZipFile(wheel) as archive:
        name = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return archive.read(name).decode()


def _installed(requirement: str, folder: Path) -> tuple[str, str, str]:
    """How the demo ends, megabytes, and seconds of CPU for the import, of an install into a fresh environment."""
    venv.create(folder, with_pip=True)
    packages = next(folder.glob("lib/python*/site-packages"))
    before = _megabytes(packages)
    subprocess.run([str(folder / "bin/pip"), "install", "--quiet", requirement], check=True)
    size = _megabytes(packages) - before
    python = folder / "bin/python"
    seconds = min(  # the first one compiles
        float(subprocess.run([python, "-c", IMPORT], check=True, capture_output=True, text=True, cwd=folder).stdout)
        for _ in range(3)
    )
    fly: list[str | Path] = [folder / "bin/fvslam", "demo", "--frames", str(DEMO_FRAMES), "--out", folder / "demo"]
    demo = subprocess.run(fly, capture_output=True, text=True, cwd=folder)
    return "runs" if demo.returncode == 0 else demo.stderr.strip(), f"{size:.0f}", f"{seconds:.2f}"


def _megabytes(folder: Path) -> float:
    return sum(file.stat().st_size for file in folder.rglob("*") if "__pycache__" not in file.parts) / 1e6


def _resolved_on_arm(requirements: list[str]) -> str:
    """Whether there are wheels of everything; pip alone would judge the markers by the machine that it runs on."""
    with tempfile.TemporaryDirectory() as folder:
        tags = [part for tag in ARM_TAGS for part in ("--platform", tag)]
        pip: list[str] = [
            sys.executable,
            "-m",
            "pip",
            "download",
            "--quiet",
            "--only-binary=:all:",
            *tags,
            "--dest",
            folder,
        ]
        if subprocess.run([*pip, *requirements]).returncode:
            return "it does not resolve"
        return f"{len(list(Path(folder).iterdir()))} wheels"


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
