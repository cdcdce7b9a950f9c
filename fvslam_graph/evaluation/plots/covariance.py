"""Whether the estimator knows how wrong it is: errors inside three sigma, ellipses on the path, NEES over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.nees import nees_band
from fvslam_graph.evaluation.plots.curve import Curve, common_unit
from fvslam_graph.evaluation.plots.style import TRUTH, legend_below, wrapped
from fvslam_graph.evaluation.pose_consistency import PoseConsistency

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BAND_SIGMAS = 3.0
_ELLIPSES = 8  # along a path
_BAND = {"color": "black", "alpha": 0.15, "linewidth": 0}


def has_covariances(curves: Sequence[Curve]) -> bool:
    """Whether any of the runs says how sure it is of poses that have a reference."""
    return any(_with_errors(curves))


def draw_covariance(figure: Figure, curves: Sequence[Curve], _: Trajectory | None) -> None:
    """Draw of each run the path with ellipses, and the error of each axis within its three sigma."""
    shown = list(_with_errors(curves))
    figure.set_figheight(1.25 * len(shown) + 1.0)
    panels = figure.subplots(len(shown), 4, squeeze=False)
    unit = common_unit(curves)
    begin = min(float(curve.run.online.stamps[0]) for curve in curves)
    for row, (curve, errors) in zip(panels, shown, strict=True):
        offsets = errors.positions @ curve.level.T
        spreads = curve.level @ errors.covariances @ curve.level.T
        times = curve.run.online.stamps[errors.frames] - begin
        _draw_ellipses(row[0], curve, errors.frames, spreads)
        row[0].set_ylabel(f"{wrapped(curve.name, 1.1)}\nforward ({unit})")
        for axis, axes in enumerate(row[1:]):
            sigma = np.sqrt(spreads[:, axis, axis])
            axes.fill_between(times, -BAND_SIGMAS * sigma, BAND_SIGMAS * sigma, **_BAND)
            axes.plot(times, offsets[:, axis], color=curve.look.colour)
            axes.axhline(0, color="black", linewidth=0.5)
            axes.sharex(row[1])
    panels[0, 0].set_title(f"from above, {BAND_SIGMAS:g}σ ellipses")
    panels[-1, 0].set_xlabel(f"right ({unit})")
    for axes, name in zip(panels[0, 1:], ("right", "forward", "up"), strict=True):
        axes.set_title(f"error {name} ({unit}) in ±{BAND_SIGMAS:g}σ")
    for axes in panels[-1, 1:]:
        axes.set_xlabel("time (s)")


def draw_nees(figure: Figure, curves: Sequence[Curve], _: Trajectory | None) -> None:
    """Draw the NEES of the poses over time, with the band in which 95 % of a consistent estimator's are."""
    figure.set_figheight(2.6)
    axes = figure.subplots()
    begin = min(float(curve.run.online.stamps[0]) for curve in curves)
    for curve, errors in _with_errors(curves):
        axes.plot(
            curve.run.online.stamps[errors.frames] - begin,
            errors.nees,
            **curve.look.line,
            label=f"{curve.name}: mean {errors.nees.mean():.3g}",
        )
    low, high = nees_band(6, 1)
    axes.axhspan(low, high, label="95 % band", **_BAND)
    axes.axhline(6, color="black", linewidth=0.8, linestyle=TRUTH["linestyle"], label="expected, 6")
    axes.set(yscale="log", xlabel="time (s)", ylabel="NEES of the pose")
    axes.yaxis.set_major_formatter("{x:g}")
    legend_below(figure, axes)


def _with_errors(curves: Sequence[Curve]) -> Iterator[tuple[Curve, PoseConsistency]]:
    for curve in curves:
        if curve.consistency is not None:
            yield curve, curve.consistency


def _draw_ellipses(axes: Axes, curve: Curve, frames: NDArray[np.int64], spreads: NDArray[np.float64]) -> None:
    """Estimate and ground truth from above, both from the first pose, with ellipses at some of the frames."""
    from matplotlib.patches import Ellipse

    assert curve.evaluation is not None
    pairs = curve.evaluation.pairs
    paths = [
        curve.level @ (side.from_origin().positions * factor).T
        for side, factor in ((pairs.estimate, curve.scale), (pairs.reference, 1.0))
    ]
    axes.plot(*paths[0][:2], color=curve.look.colour)
    axes.plot(*paths[1][:2], **TRUTH)
    for number in np.unique(np.linspace(0, len(frames) - 1, _ELLIPSES + 1).astype(int)[1:]):
        centre = paths[0][:2, np.searchsorted(pairs.indices, frames[number])]
        width, height, angle = ellipse(spreads[number, :2, :2], BAND_SIGMAS)
        axes.add_patch(Ellipse(centre, width, height, angle=angle, fill=False, color=curve.look.colour, linewidth=0.8))
    axes.set_aspect("equal", adjustable="datalim")


def ellipse(covariance: NDArray[np.float64], sigmas: float) -> tuple[float, float, float]:
    """Full axes and angle (degrees) of the ellipse of a covariance (2, 2)."""
    values, vectors = np.linalg.eigh(covariance)
    width, height = 2 * sigmas * np.sqrt(np.maximum(values, 0))
    return float(width), float(height), float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
