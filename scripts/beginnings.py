"""How well odometry begins: pieces of recordings, each as a recording of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from one_sentence import one_sentence
from pages import save_table

import fvslam_graph
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.sequences.open import open_sequence

COLUMNS = ("recording", "images", "pieces", "geometric mean (%)", "worst (%)", "second worst (%)")


def main(
    paths: Annotated[list[str], typer.Argument(help="Recordings with ground truth.")],
    mode: str = "vo",
    length: Annotated[int, typer.Option(help="Frames of a piece.")] = 40,
    pieces: Annotated[int, typer.Option(help="About as many of each recording.")] = 12,
    out: Annotated[Path, typer.Option(help="Folder for the table.")] = Path("runs") / "beginnings",
) -> None:
    """Make a table: APE over the length of the path, of pieces that begin anywhere in the recordings."""
    cv2.setNumThreads(1)
    rows = []
    for path in paths:
        whole = open_sequence(path)
        for size, sequence in (("as they are", whole), ("half the size", whole.scaled(0.5))):
            errors = np.sort(_errors(sequence, mode, length, pieces))
            if len(errors) < 2:
                raise FvslamError(f"{path} has fewer than two pieces of {length} frames with a reference")
            mean = np.exp(np.log(errors).mean())
            cells = (f"{100 * error:.2g}" for error in (mean, errors[-1], errors[-2]))
            rows.append([whole.name, size, str(len(errors)), *cells])
    caption = f"`{mode}`, online, one seed: APE after Sim(3) over the length of the path, pieces of {length} frames."
    save_table(out, "beginnings", Table(COLUMNS, rows, caption=caption))


def _errors(sequence: Sequence, mode: str, length: int, pieces: int) -> list[float]:
    """Of the pieces that most frames of have a reference, and in which the camera moves."""
    last = len(sequence) - length
    errors = []
    for start in range(0, last + 1, max(1, last // pieces)):
        piece = sequence.select(start, start + length)
        assert piece.ground_truth is not None
        known = piece.ground_truth.interpolate(piece.stamps)
        if len(known) > length / 2 and known.path_length > 0.01:
            evaluation = fvslam_graph.evaluate(fvslam_graph.run(piece, mode), align="sim3")
            errors.append(evaluation.errors["ape_trans"].stats["rmse"] / known.path_length)
    return errors


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
