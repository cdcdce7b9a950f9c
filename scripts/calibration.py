"""What a wrong calibration costs in flights rendered through a lens, and what recordings show of such a lens."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from one_sentence import one_sentence
from pages import save_table

import fvslam_graph
from fvslam_graph.core.camera import Camera, Distortion
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.runs.results import Run
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.vo.self_calibration import RecordingCalibration, calibrate_by_tracks

WORLD = "synthetic:uav?frames=200"  # one flight, one seed; drives and other flights are left out
LENSES = ((0.0, 0.0), (0.02, 0.0), (0.02, 0.03), (-0.02, -0.03))  # k1, and what the file's focal length is off
MODES = ("vo", "average", "graph")
ALL_MODES = (*MODES, "vslam")

Out = Annotated[Path, typer.Option(help="Folder for the table.")]
OUT = Path("runs") / "calibration"

app = typer.Typer()


@app.command()
def lens(out: Out = OUT) -> None:
    """Make a table: APE with and without `vo.calibrate` of a flight through each lens, and what the graph finds."""
    cv2.setNumThreads(1)
    world = open_sequence(WORLD)
    rows = [[_named(*lens), *_cells(_through(world, *lens), world.camera.fx)] for lens in LENSES]
    columns = ("lens", *MODES, "k1 at the end", "focal length off (%)")
    caption = f"{WORLD}, APE after Sim(3) (m), one seed; in brackets without `vo.calibrate`."
    save_table(out, "lens", Table(columns, rows, caption=caption))


@app.command()
def recordings(paths: Annotated[list[str], typer.Argument(help="Recordings.")], out: Out = OUT) -> None:
    """Make two tables: what is left of each recording's calibration, and what modes err with it taken out.

    Also by what another recording of the same camera says, which has seen nothing of this one.
    """
    cv2.setNumThreads(1)
    sequences = [open_sequence(path) for path in paths]
    found = [calibrate_by_tracks(sequence) for sequence in sequences]
    columns = ["recording", "pairs", "focal length (%)", "centre (pixels)", "k1", "k2", "p1", "p2"]
    rows = [[sequence.name, *_left(sequence.camera, own)] for sequence, own in zip(sequences, found, strict=True)]
    save_table(out, "left", Table(columns, rows, caption="Standard deviations; values of what is certain."))
    rows = [
        [sequence.name, by.name, *_before_and_after(sequence, own.camera)]
        for sequence in sequences
        for by, own in zip(sequences, found, strict=True)
        if _same_camera(sequence, by) and own.corrected
    ]
    modes = [f"{mode} (m)" for mode in ALL_MODES]
    columns = ["recording", "calibrated by", *modes, "vo (deg/100 m)"]
    save_table(out, "taken-out", Table(columns, rows, caption="APE after Sim(3), and r_rel; before, after; one seed."))


def _same_camera(sequence: Sequence, other: Sequence) -> bool:
    """Whether both are one, or recordings of one camera; worlds are rendered as by the cameras of recordings."""
    world = any(name.startswith("synthetic:") for name in (sequence.name, other.name))
    return sequence is other or (sequence.camera == other.camera and not world)


def _left(camera: Camera, own: RecordingCalibration) -> Iterator[str]:
    """How many pairs, and by how much each number is off, with its standard deviation."""
    found, sigmas = own.camera, own.sigmas
    yield str(own.pairs)
    yield _certain(100 * (found.fx / camera.fx - 1), 100 * sigmas[0] / camera.fx, 1)
    right, down = found.cx - camera.cx, found.cy - camera.cy
    yield f"{_certain(right, sigmas[2], 1)}, {_certain(down, sigmas[3], 1)}"
    for value, sigma in zip(found.coefficients, sigmas[4:], strict=True):
        yield _certain(value, sigma, 4)


def _certain(value: float, sigma: float, digits: int) -> str:
    return f"{value:.{digits}f} +- {sigma:.{digits}f}" if value else f"+- {sigma:.{digits}f}"


def _before_and_after(sequence: Sequence, camera: Camera) -> Iterator[str]:
    turns = []
    for mode in ALL_MODES:
        runs = [fvslam_graph.run(recording, mode) for recording in (sequence, sequence.recalibrated(camera))]
        yield ", ".join(f"{_ape(run):#.2g}" for run in runs)
        turns += [fvslam_graph.evaluate(run).drift.r_rel for run in runs if mode == "vo"]
    yield ", ".join(f"{turn:#.2g}" for turn in turns)


def _named(k1: float, focal: float) -> str:
    parts = [f"k1 = {k1:g}"] * bool(k1) + [f"focal length {focal:+.0%}"] * bool(focal)
    return ", ".join(parts).replace("%", " %") or "as the file says"


def _through(world: Sequence, k1: float, focal: float) -> Sequence:
    """The world as a lens with k1 shows it, with a file that says nothing of k1 and another focal length."""
    camera, images = world.camera, [frame.image for frame in world]
    if k1:
        bent = replace(camera, distortion=Distortion.RADTAN, coefficients=(k1, 0, 0, 0))
        v, u = np.mgrid[: camera.height, : camera.width]
        seen = camera.project(bent.rays(np.column_stack([u.ravel(), v.ravel()]).astype(float))).astype(np.float32)
        where = seen.reshape(camera.height, camera.width, 2)
        images = [
            cv2.remap(image, where, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
            for image in images
            if image is not None
        ]
    filed = replace(camera, fx=camera.fx * (1 + focal), fy=camera.fy * (1 + focal))
    return replace(world, camera=filed, load=images.__getitem__, source=None)


def _cells(sequence: Sequence, true_focal_length: float) -> Iterator[str]:
    for mode in MODES:
        run = fvslam_graph.run(sequence, mode)
        without = fvslam_graph.run(sequence, mode, settings={"vo.calibrate": False})
        yield f"{_ape(run):#.2g} ({_ape(without):#.2g})"
    found = run.info["calibration"]  # of the graph, which is the last one
    yield f"{found['k1']:.4f} +- {found['k1_sigma']:.4f}"
    off, sigma = found["focal_length"] / true_focal_length - 1, found["focal_sigma"] / true_focal_length
    yield f"{100 * off:.1f} +- {100 * sigma:.1f}"


def _ape(run: Run) -> float:
    rmse: float = fvslam_graph.evaluate(run, align="sim3").errors["ape_trans"].stats["rmse"]
    return rmse


if __name__ == "__main__":
    with one_sentence():
        app()
