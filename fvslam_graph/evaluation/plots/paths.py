"""Paths from above and from the side; where they coincide, also with their errors magnified."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.plots.curve import Curve, common_unit
from fvslam_graph.evaluation.plots.style import TRUTH, legend_below

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MIN_MAGNIFICATION = 5  # less shows in the path itself
_MAGNIFIED_SHARE = 0.15  # of the extent of the path that its largest error may take, magnified
_ABOVE, _SIDE = (0, 1), (1, 2)


def draw_paths(figure: Figure, curves: Sequence[Curve], truth: Trajectory | None) -> None:
    """Draw the paths; a third panel magnifies their errors where these are too small to be seen."""
    factor = magnification(curves)
    heights = (2, 1) if factor is None else (2, 1, 2)
    figure.set_figheight(1.1 * sum(heights) + 0.8)
    panels = figure.subplots(len(heights), 1, height_ratios=heights)
    for axes, plane in zip(panels, (_ABOVE, _SIDE, _ABOVE), strict=False):
        _draw_truth(axes, truth or curves[0].estimate, plane, truth is not None)
    for axes, plane in zip(panels, (_ABOVE, _SIDE), strict=False):
        for curve in curves:
            axes.plot(*curve.estimate.positions[:, plane].T, **curve.look.line, label=curve.name)
    unit = common_unit(curves)
    panels[0].set(title="from above", xlabel=f"right ({unit})", ylabel=f"forward ({unit})")
    panels[1].set(title="from the side", xlabel=f"forward ({unit})", ylabel=f"up ({unit})")
    if factor is not None:
        for curve in curves:
            if curve.reference is not None:
                path = magnified(curve.estimate.positions, curve.reference, factor)
                panels[2].plot(*path[:, _ABOVE].T, **curve.look.line)
        panels[2].set(title=f"from above, errors × {factor}", xlabel=f"right ({unit})", ylabel=f"forward ({unit})")
    legend_below(figure, panels[0])


def magnification(curves: Sequence[Curve]) -> int | None:
    """The factor of 1, 2 or 5 times a power of ten that makes errors visible; None where they are, or are none."""
    known = [(curve.estimate.positions, curve.reference) for curve in curves if curve.reference is not None]
    worst = max((float(np.abs(estimate - reference).max()) for estimate, reference in known), default=0.0)
    extent = max((float(np.ptp(reference, axis=0).max()) for _, reference in known), default=0.0)
    if not worst > 1e-9 * extent:
        return None
    wanted = _MAGNIFIED_SHARE * extent / worst
    power = 10 ** max(int(np.floor(np.log10(wanted))), 0) if wanted > 0 else 1
    factor = max((step * power for step in (1, 2, 5) if step * power <= wanted), default=1)
    return factor if factor >= MIN_MAGNIFICATION else None


def magnified(positions: NDArray[np.float64], reference: NDArray[np.float64], factor: float) -> NDArray[np.float64]:
    """Positions (M, 3) at `factor` times their distances from the reference (M, 3)."""
    return reference + factor * (positions - reference)


def _draw_truth(axes: Axes, path: Trajectory, plane: tuple[int, int], known: bool) -> None:
    """The ground truth, where it is known, and where the path begins."""
    if known:
        axes.plot(*path.positions[:, plane].T, **TRUTH)
    axes.plot(*path.positions[0, plane], "o", color="black", markersize=4, label="start", zorder=4)
    axes.set_aspect("equal", adjustable="datalim")
