"""Figures of one or several runs on the same sequence, as PNG and PDF."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.extras import require
from fvslam_graph.core.files import writing
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.plots.covariance import draw_covariance, draw_nees, has_covariances
from fvslam_graph.evaluation.plots.curve import Curve, curve_of
from fvslam_graph.evaluation.plots.errors import draw_drift, draw_errors
from fvslam_graph.evaluation.plots.frames import draw_features, draw_speed
from fvslam_graph.evaluation.plots.paths import draw_paths
from fvslam_graph.evaluation.plots.style import COLUMN_WIDTH, PAGE_WIDTH, STYLE, legible, save, wrapped
from fvslam_graph.runs.ownership import claim_files
from fvslam_graph.runs.results import Run
from fvslam_graph.runs.run_folder import FIGURES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Draw = Callable[["Figure", Sequence[Curve], Trajectory | None], None]
_PAGE_WIDE = ("drift", "covariance")
_SINCE_START = ("covariance", "nees")  # poses are as uncertain as the way to them, and are compared without alignment


def plot_runs(
    runs: Sequence[Run],
    out: Path,
    align: Alignment = Alignment.SE3,
    figures: Sequence[str] = FIGURES,
    suffixes: Sequence[str] = (".png", ".pdf"),
) -> list[Path]:
    """Draw the online trajectories of runs on the same sequence, what their errors are and what the estimator saw.

    Writes `plot_NAME` for each of FIGURES. Runs without ground truth are drawn in their own first camera frame and
    have no errors; runs without covariances of their poses are left out of `covariance` and `nees`.

    Args:
        runs: Their names are in the legends.
        out: Folder for the figures, created.
        align: How the estimates are brought into the world of the ground truth.
        figures: Which of FIGURES.
        suffixes: Of the files, one for each format.

    Returns:
        The files.

    Raises:
        ResultsError: The runs are of different sequences or hold fewer than two poses, or `out` cannot be written.
        TrajectoryError: The ground truth of a run has no time in common with it.
    """
    require("eval")
    import matplotlib
    from matplotlib.figure import Figure

    _require_comparable(runs)
    level = np.eye(4)
    down = runs[0].info.get("down")
    level[:3, :3] = level_axes(np.array((0.0, 1.0, 0.0) if down is None else down))
    truth = _ground_truth(runs)
    origin = truth.poses[0].inverse().matrix() if truth else np.eye(4)
    curves = [curve_of(run, align, number, level[:3, :3], origin) for number, run in enumerate(runs)]
    if truth:
        truth = Trajectory.from_matrices(truth.stamps, level @ origin @ truth.matrices)

    files = []
    with writing(out), matplotlib.rc_context(STYLE):
        claim_files(out, [f"plot_{name}{suffix}" for name in figures for suffix in suffixes])
        for name, draw in _drawings(curves).items():
            if name in figures:
                width = PAGE_WIDTH if name in _PAGE_WIDE else COLUMN_WIDTH
                figure = Figure(figsize=(width, 4), layout="constrained")
                figure.suptitle(_title(curves, width, aligned=name not in _SINCE_START))
                draw(figure, curves, truth)
                files += save(figure, out / f"plot_{name}", suffixes)
    return files


def level_axes(down: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows right, forward, up, (3, 3), in camera coordinates, for a direction of gravity (3,) in the camera.

    Forward is where the camera looks; for a camera that looks down, the upper edge of its image.
    """
    down = down / np.linalg.norm(down)
    ahead = np.array([0.0, 0.0, 1.0]) if abs(down[2]) < 0.9 else np.array([0.0, -1.0, 0.0])
    right = np.cross(down, ahead)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(right, down), -down])


def _require_comparable(runs: Sequence[Run]) -> None:
    names = sorted({str(run.info.get("sequence")) for run in runs})
    if len(names) > 1:
        raise ResultsError(f"the runs are of different sequences, {', '.join(names)}; plot each sequence on its own")
    for run in runs:
        if len(run.online) < 2:
            raise ResultsError(
                f"{run.folder or run.name} holds too few poses to plot, {len(run.online)}; two are needed"
            )


def _drawings(curves: Sequence[Curve]) -> dict[str, Draw]:
    """The figures that there is something to draw of."""
    drawings: dict[str, Draw] = {"trajectory": draw_paths}
    if any(curve.evaluation for curve in curves):
        drawings |= {"error": draw_errors, "drift": draw_drift}
    if has_covariances(curves):
        drawings |= {"covariance": draw_covariance, "nees": draw_nees}
    if any(curve.run.frames for curve in curves):
        drawings |= {"speed": draw_speed, "features": draw_features}
    return drawings


def _ground_truth(runs: Sequence[Run]) -> Trajectory | None:
    """The ground truth of the first run that has it, for as long as the runs last."""
    for run in runs:
        if run.ground_truth is not None:
            return run.ground_truth.between(
                min(run.online.stamps[0] for run in runs), max(run.online.stamps[-1] for run in runs)
            )
    return None


def _title(curves: Sequence[Curve], width: float, aligned: bool) -> str:
    """What is compared and how, in lines that are no wider than the figure (inches)."""
    sequence = legible(curves[0].run.info.get("sequence") or "unnamed sequence")
    alignments = {str(curve.evaluation.alignment) for curve in curves if curve.evaluation}
    sources = {curve.run.info.get("scale_source") or "unknown" for curve in curves}
    shares = sorted({f"{100 * curve.run.coverage:.0f}\u00a0%" for curve in curves})
    how = f"{'/'.join(sorted(alignments))} alignment" if aligned else "first poses aligned"
    if not aligned and any(curve.scale != 1 for curve in curves):
        how += ", scale of the sim3 alignment"
    facts = (
        "online trajectory",
        how if alignments else "no ground truth",
        f"scale from {'/'.join(sorted(sources))}",
        f"coverage {'/'.join(shares)}",
    )
    return f"{wrapped(sequence, width)}\n{wrapped(', '.join(facts), width)}"
