"""Figures of one or several runs on the same sequence, as PNG and PDF."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.extras import require
from fvslam_graph.core.files import one_line, write_file, writing
from fvslam_graph.core.trajectory import Status, Trajectory
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.association import TrajectoryPairs
from fvslam_graph.evaluation.metrics import Evaluation
from fvslam_graph.evaluation.runs import evaluation_of
from fvslam_graph.runs.ownership import claim_files
from fvslam_graph.runs.results import Relatives, Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette, which colour-blind readers can tell apart.
RUN_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#888888", "#C0B000")
STATUS_COLOURS = {
    Status.STATIC: "#999999",
    Status.UNSCALED: "#56B4E9",
    Status.COASTED: "#E69F00",
    Status.SKIPPED: "#D55E00",
    Status.REINITIALISED: "#CC79A7",
}
TRUTH = {"color": "black", "linestyle": (0, (4, 2)), "linewidth": 1.2, "label": "ground truth", "zorder": 3}
STYLE = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "savefig.dpi": 150,
    "pdf.fonttype": 42,  # text stays text in the PDF
    "svg.fonttype": "none",  # and in the SVG
    "svg.hashsalt": "fvslam",
    "text.parse_math": False,  # a dollar in a name is a dollar
}
MAX_NAME_IN_FIGURE = 60  # characters of a name in a figure


@dataclass(frozen=True)
class _Curve:
    """A run as it is drawn: aligned, in a frame whose axes are right, forward and up."""

    run: Run
    evaluation: Evaluation | None
    colour: str
    estimate: Trajectory


FIGURES = ("trajectory", "speed", "features", "error")


def plot_runs(
    runs: Sequence[Run],
    out: Path,
    align: Alignment = Alignment.SE3,
    figures: Sequence[str] = FIGURES,
    suffixes: Sequence[str] = (".png", ".pdf"),
) -> list[Path]:
    """Draw the online trajectories of runs on the same sequence, what their errors are and what the estimator saw.

    Writes `plot_trajectory`, `plot_speed`, `plot_features` and `plot_error`. Runs without ground truth are drawn in
    their own first camera frame and have no error.

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

    _require_drawable(runs)
    level = np.eye(4)
    down = runs[0].info.get("down")
    level[:3, :3] = level_axes(np.array((0.0, 1.0, 0.0) if down is None else down))
    truth = _ground_truth(runs)
    origin = truth.poses[0].inverse().matrix() if truth else np.eye(4)
    curves = [_curve(run, align, colour, level, origin) for run, colour in zip(runs, cycle(RUN_COLOURS), strict=False)]
    if truth:
        truth = Trajectory.from_matrices(truth.stamps, level @ origin @ truth.matrices)

    drawings: dict[str, Callable[[Figure, Sequence[_Curve], Trajectory | None], None]] = {
        "trajectory": _draw_trajectory,
        "speed": _draw_speed,
        "features": _draw_features,
        "error": _draw_error,
    }
    files = []
    with writing(out), matplotlib.rc_context(STYLE):
        claim_files(out, [f"plot_{name}{suffix}" for name in figures for suffix in suffixes])
        for name in figures:
            if name == "error" and not any(curve.evaluation for curve in curves):
                continue
            figure = _figure(curves)
            drawings[name](figure, curves, truth)
            files += save(figure, out / f"plot_{name}", suffixes)
    return files


def _require_drawable(runs: Sequence[Run]) -> None:
    names = sorted({str(run.info.get("sequence")) for run in runs})
    if len(names) > 1:
        raise ResultsError(f"the runs are of different sequences, {', '.join(names)}; plot each sequence on its own")
    for run in runs:
        if len(run.online) < 2:
            raise ResultsError(
                f"{run.folder or run.name} holds too few poses to plot, {len(run.online)}; two are needed"
            )


def legible(name: str) -> str:
    """A name as it is written in figures; matplotlib leaves what begins with an underscore out of legends."""
    name = one_line(name)
    short = name if len(name) <= MAX_NAME_IN_FIGURE else f"{name[: MAX_NAME_IN_FIGURE - 1]}…"
    return f" {short}" if short.startswith("_") else short


def save(figure: Figure, stem: Path, suffixes: Sequence[str]) -> list[Path]:
    """Write a figure once for each suffix, always with the same bytes; returns the files."""
    files = []
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # of a name in letters that the font has not: boxes
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # laid out once, and not for every format
        for suffix in suffixes:
            files.append(stem.with_name(stem.name + suffix))
            undated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}.get(suffix)
            content = io.BytesIO()
            figure.savefig(content, format=suffix[1:], metadata=undated)
            write_file(files[-1], content.getvalue())
    return files


def _ground_truth(runs: Sequence[Run]) -> Trajectory | None:
    """The ground truth of the first run that has it, for as long as the runs last."""
    for run in runs:
        if run.ground_truth is not None:
            return run.ground_truth.between(
                min(run.online.stamps[0] for run in runs), max(run.online.stamps[-1] for run in runs)
            )
    return None


def _curve(run: Run, align: Alignment, colour: str, level: NDArray[np.float64], origin: NDArray[np.float64]) -> _Curve:
    if run.ground_truth is None:
        own = run.online.from_origin()
        return _Curve(run, None, colour, Trajectory.from_matrices(own.stamps, level @ own.matrices))
    evaluation = evaluation_of(run, None, align)
    aligned = evaluation.errors["ape_trans"].trajectories[evaluation.name]
    poses = level @ origin @ np.array(aligned.poses_se3)
    return _Curve(run, evaluation, colour, Trajectory.from_matrices(aligned.timestamps, poses))


def level_axes(down: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows right, forward, up, (3, 3), in camera coordinates, for a direction of gravity (3,) in the camera.

    Forward is where the camera looks; for a camera that looks down, the upper edge of its image.
    """
    down = down / np.linalg.norm(down)
    ahead = np.array([0.0, 0.0, 1.0]) if abs(down[2]) < 0.9 else np.array([0.0, -1.0, 0.0])
    right = np.cross(down, ahead)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(right, down), -down])


def _figure(curves: Sequence[_Curve]) -> Figure:
    """An empty figure whose title says what is compared and how."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 7), layout="constrained")
    sequence = legible(curves[0].run.info.get("sequence") or "unnamed sequence")
    alignments = {str(curve.evaluation.alignment) for curve in curves if curve.evaluation}
    sources = {curve.run.info.get("scale_source") or "unknown" for curve in curves}
    shares = sorted({f"{100 * curve.run.coverage:.0f} %" for curve in curves})
    facts = (
        "online trajectory",
        f"{'/'.join(sorted(alignments))} alignment" if alignments else "no ground truth",
        f"scale from {'/'.join(sorted(sources))}",
        f"coverage {'/'.join(shares)}",
    )
    figure.suptitle(f"{sequence}\n{', '.join(facts)}", fontsize=11)
    return figure


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))


def _draw_trajectory(figure: Figure, curves: Sequence[_Curve], truth: Trajectory | None) -> None:
    above, side = figure.subplots(2, 1, height_ratios=(2, 1))
    for axes, (x, y) in ((above, (0, 1)), (side, (1, 2))):
        for curve in curves:
            axes.plot(*curve.estimate.positions[:, (x, y)].T, color=curve.colour, label=legible(curve.run.name))
        if truth:
            axes.plot(*truth.positions[:, (x, y)].T, **TRUTH)
        axes.plot(*(truth or curves[0].estimate).positions[0, (x, y)], "o", color="black", markersize=5, label="start")
        axes.set_aspect("equal", adjustable="datalim")
    above.set(title="from above", xlabel="right (m)", ylabel="forward (m)")
    side.set(title="from the side", xlabel="forward (m)", ylabel="up (m)")
    _legend(figure, above)


def _draw_error(figure: Figure, curves: Sequence[_Curve], _: Trajectory | None) -> None:
    panels = figure.subplots(2, 1, sharex=True)
    for axes, key, label in zip(panels, ("ape_trans", "ape_rot"), ("translation (m)", "rotation (deg)"), strict=True):
        for curve in curves:
            if curve.evaluation is not None:
                error = curve.evaluation.errors[key]
                name = f"{legible(curve.run.name)} (RMSE {curve.evaluation.errors['ape_trans'].stats['rmse']:.3g} m)"
                distances = error.np_arrays["distances_from_start"]
                axes.plot(distances, error.np_arrays["error_array"], color=curve.colour, label=name)
        axes.set_ylabel(f"absolute error,\n{label}")
        axes.set_ylim(bottom=0)
    panels[-1].set_xlabel("travelled distance of the ground truth (m)")
    _legend(figure, panels[0])


def _draw_speed(figure: Figure, curves: Sequence[_Curve], truth: Trajectory | None) -> None:
    scaled = [curve for curve in curves if np.isfinite(curve.run.frames.get("scale", np.nan)).any()]
    speed, *panels = np.atleast_1d(figure.subplots(1 + len(scaled), 1, sharex=True))
    begin = min(float(curve.run.online.stamps[0]) for curve in curves)
    for curve in curves:
        speed.plot(*_speeds(curve.estimate, begin), color=curve.colour, label=legible(curve.run.name))
    if truth:
        speed.plot(*_speeds(truth, begin), **TRUTH)
    speed.set_ylabel("speed (m/s)")
    speed.set_ylim(bottom=0)
    for axes, curve in zip(panels, scaled, strict=True):
        known = np.isfinite(curve.run.frames["scale"])  # not every frame estimates one
        times, scale = (curve.run.online.stamps - begin)[known], curve.run.frames["scale"][known]
        axes.plot(times, scale, color=curve.colour)
        if "scale_sigma" in curve.run.frames:
            margin = 2 * curve.run.frames["scale_sigma"][known]
            axes.fill_between(times, scale - margin, scale + margin, color=curve.colour, alpha=0.25, linewidth=0)
        if curve.evaluation is not None and curve.run.relatives is not None:
            axes.plot(times, _baselines(curve.evaluation.pairs, curve.run.relatives)[known], **TRUTH)
        axes.set_ylabel("scale ± 2σ\n(m per baseline)")
        axes.set_title(legible(curve.run.name), fontsize=9)
    (panels or [speed])[-1].set_xlabel("time (s)")
    _legend(figure, speed)


def _draw_features(figure: Figure, curves: Sequence[_Curve], _: Trajectory | None) -> None:
    panels = np.atleast_1d(figure.subplots(len(curves), 1, sharex=True))
    for axes, curve in zip(panels, curves, strict=True):
        frames = curve.run.frames
        for name, alpha in (("tracks", 0.4), ("inliers", 1.0)):
            if name in frames:
                line = f"{name}, {legible(curve.run.name)}"
                axes.plot(frames["index"], frames[name], color=curve.colour, alpha=alpha, label=line)
        for status, colour in STATUS_COLOURS.items():
            here = frames["status"] == status
            edges = np.flatnonzero(np.diff(here, prepend=False, append=False)).reshape(-1, 2)
            if len(edges):
                spans = [(start - 0.5, end - start) for start, end in edges]
                axes.broken_barh(
                    spans, (0, 1), transform=axes.get_xaxis_transform(), color=colour, alpha=0.35, label=status.value
                )
        axes.set_ylabel("features")
        axes.set_ylim(bottom=0)
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1))
    panels[-1].set_xlabel("frame")


def _baselines(pairs: TrajectoryPairs, relatives: Relatives) -> NDArray[np.float64]:
    """Metres between each frame and the one that its motion was measured from, (N,); NaN where there is none."""
    positions = np.full((len(relatives.previous), 3), np.nan)
    positions[pairs.indices] = pairs.reference.positions
    baselines = np.linalg.norm(positions - positions[relatives.previous], axis=1)
    return np.where(relatives.previous == np.arange(len(baselines)), np.nan, baselines)


def _speeds(trajectory: Trajectory, begin: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times since `begin` (s) and speeds (m/s) from pose to pose."""
    steps = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1)
    return trajectory.stamps[1:] - begin, steps / np.diff(trajectory.stamps)
