"""How noisy the references of recordings are, and which NEES of odometry they can judge."""

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
from fvslam_graph.evaluation.report import UNJUDGED
from fvslam_graph.evaluation.tables import Table

COLUMNS = ("recording", "position (mm)", "rotation (mrad)", "tilt (deg)", "adds to 6", "NEES", "of rotations")


def main(
    paths: Annotated[list[str], typer.Argument(help="Recordings with ground truth.")],
    out: Annotated[Path, typer.Option(help="Folder for the table.")] = Path("runs") / "reference_quality",
) -> None:
    """Make a table: noise of the reference from frame to frame, and the NEES of `vo`, online, Sim(3)."""
    cv2.setNumThreads(1)
    rows = [_row(path) for path in paths]
    caption = (
        "`vo`, online, Sim(3), one seed. NEES of poses, where 6 is consistent, and of their rotations, where 3 is."
    )
    save_table(out, "reference-quality", Table(COLUMNS, rows, caption=caption))


def _row(path: str) -> list[str]:
    evaluation = fvslam_graph.evaluate(fvslam_graph.run(path, "vo"), align="sim3")
    quality, nees = evaluation.reference, evaluation.nees
    if quality is None or not nees:
        raise FvslamError(f"{path} has no motions with a covariance and a reference")
    judged = (f"{nees[part].mean:.1f}" if nees[part].judged else UNJUDGED for part in ("pose", "rotation"))
    return [
        path if path.startswith("synthetic:") else Path(path).name,
        f"{1000 * quality.position:.2g}",
        f"{1000 * quality.rotation:.2g}",
        f"{np.degrees(quality.tilt):.2g}",
        f"{nees['pose'].added:.1f}",
        *judged,
    ]


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
