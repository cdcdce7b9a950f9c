"""What the estimator said frame by frame: speed, scale, features and status."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.trajectory import Status, Trajectory
from fvslam_graph.evaluation.association import TrajectoryPairs
from fvslam_graph.evaluation.plots.curve import Curve, common_unit
from fvslam_graph.evaluation.plots.style import TRUTH, legend_below

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STATUS_LOOKS = {
    Status.STATIC: ("#999999", ""),
    Status.UNSCALED: ("#56B4E9", "----"),
    Status.COASTED: ("#E69F00", "////"),
    Status.SKIPPED: ("#D55E00", "xxxx"),
    Status.REINITIALISED: ("#CC79A7", "...."),
}
_PANEL_HEIGHT = 0.85  # inches


def draw_speed(figure: Figure, curves: Sequence[Curve], truth: Trajectory | None) -> None:
    """Draw the speed, and of each run the scale of odometry's baselines beside their true lengths."""
    scaled = [curve for curve in curves if np.isfinite(curve.run.frames.get("scale", np.nan)).sum() > 1]
    figure.set_figheight(2.2 + _PANEL_HEIGHT * len(scaled))
    heights = [2, *[1] * len(scaled)]
    speed, *panels = np.atleast_1d(figure.subplots(len(heights), 1, sharex=True, height_ratios=heights))
    begin = min(float(curve.run.online.stamps[0]) for curve in curves)
    for curve in curves:
        speed.plot(*_speeds(curve.estimate, begin), **curve.look.line, label=curve.name)
    if truth:
        speed.plot(*_speeds(truth, begin), **TRUTH)
    speed.set(ylabel=f"speed ({common_unit(curves)}/s)")
    speed.set_ylim(bottom=0)
    for axes, curve in zip(panels, scaled, strict=True):
        _draw_scale(axes, curve, begin)
    (panels or [speed])[-1].set_xlabel("time (s)")
    legend_below(figure, speed)


def draw_features(figure: Figure, curves: Sequence[Curve], _: Trajectory | None) -> None:
    """Draw how many features were tracked and agreed, and where the pose is no measurement."""
    curves = [curve for curve in curves if curve.run.frames]
    figure.set_figheight(0.8 + _PANEL_HEIGHT * len(curves))
    panels = np.atleast_1d(figure.subplots(len(curves), 1, sharex=True))
    seen = {status for curve in curves for status in _STATUS_LOOKS if (curve.run.frames["status"] == status).any()}
    for axes, curve in zip(panels, curves, strict=True):
        frames = curve.run.frames
        for name, line in (("tracks", ":"), ("inliers", "-")):
            if name in frames:
                axes.plot(frames["index"], frames[name], line, color=curve.look.colour, label=name)
        for status, (colour, hatch) in _STATUS_LOOKS.items():
            if status in seen:
                here = frames["status"] == status
                edges = np.flatnonzero(np.diff(here, prepend=False, append=False)).reshape(-1, 2)
                axes.broken_barh(
                    [(start - 0.5, end - start) for start, end in edges],
                    (0, 1),
                    transform=axes.get_xaxis_transform(),
                    **{"facecolor": colour, "hatch": hatch, "alpha": 0.4, "label": status.value},
                )
        axes.set_title(curve.name)
        axes.set_ylabel("features")
        axes.set_ylim(bottom=0)
    panels[-1].set_xlabel("frame")
    legend_below(figure, panels[0])


def _draw_scale(axes: Axes, curve: Curve, begin: float) -> None:
    """The estimated length of the baseline since the keyframe, with two sigma, and the true one."""
    frames = curve.run.frames
    known = np.isfinite(frames["scale"])  # not every frame estimates one
    times, scale = (curve.run.online.stamps - begin)[known], curve.scale * frames["scale"][known]
    axes.plot(times, scale, color=curve.look.colour)
    if "scale_sigma" in frames:
        margin = 2 * curve.scale * frames["scale_sigma"][known]
        axes.fill_between(times, scale - margin, scale + margin, color=curve.look.colour, alpha=0.25, linewidth=0)
    if curve.evaluation is not None and "keyframe" in frames:
        keyframes = np.nan_to_num(frames["keyframe"][known], nan=-1).astype(int)
        axes.plot(times, baselines(curve.evaluation.pairs, keyframes, np.flatnonzero(known)), **TRUTH)
    axes.set(ylabel=f"{curve.unit} per\nbaseline", title=f"scale ± 2σ, {curve.name}")


def baselines(pairs: TrajectoryPairs, keyframes: NDArray[np.int64], frames: NDArray[np.int64]) -> NDArray[np.float64]:
    """Metres between K frames and their keyframes, (K,) each by their index; NaN where one has no reference."""
    positions = np.full((1 + max(frames.max(initial=0), pairs.indices.max()), 3), np.nan)
    positions[pairs.indices] = pairs.reference.positions
    known = (keyframes >= 0) & (keyframes < frames)
    return np.where(known, np.linalg.norm(positions[frames] - positions[np.where(known, keyframes, 0)], axis=1), np.nan)


def _speeds(trajectory: Trajectory, begin: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times since `begin` (s) and speeds (m/s) from pose to pose."""
    steps = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1)
    return trajectory.stamps[1:] - begin, steps / np.diff(trajectory.stamps)
