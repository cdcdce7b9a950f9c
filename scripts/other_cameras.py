"""How well an estimator does with images as other cameras would have made them: darker corners, lamps, the vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from one_sentence import one_sentence
from pages import save_table

import fvslam_graph
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.simulation.other_cameras import EFFECTS, seen_by


def main(
    recordings: Annotated[list[str], typer.Argument(help="Recordings with ground truth.")],
    mode: str = "vo",
    out: Annotated[Path, typer.Option(help="Folder for the table.")] = Path("runs") / "other_cameras",
) -> None:
    """Make a table: APE of each recording as it is, and what becomes of it with each effect."""
    cv2.setNumThreads(1)
    rows, ratios = [], []
    for sequence in map(open_sequence, recordings):
        error = _error(sequence, mode)
        ratios.append([_error(seen_by(sequence, effect), mode) / error for effect in EFFECTS.values()])
        rows.append([sequence.name, f"{error:.2g}", *_cells(ratios[-1])])
    rows.append(["geometric mean", "", *_cells(np.exp(np.log(ratios).mean(axis=0)).tolist())])
    caption = f"`{mode}`, online, one seed: APE after Sim(3) (m), and how many times as much it is with each effect."
    save_table(out, "other-cameras", Table(("recording", "APE (m)", *EFFECTS), rows, caption=caption))


def _error(sequence: Sequence, mode: str) -> float:
    evaluation = fvslam_graph.evaluate(fvslam_graph.run(sequence, mode), align="sim3")
    return float(evaluation.errors["ape_trans"].stats["rmse"])


def _cells(ratios: list[float]) -> list[str]:
    return [f"{ratio:.2f}" for ratio in ratios]


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
