"""Errors along the path, and their spread by the length of segments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.drift import LENGTHS, SegmentErrors, segment_errors
from fvslam_graph.evaluation.plots.curve import Curve, common_unit
from fvslam_graph.evaluation.plots.style import legend_below

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MIN_LENGTHS = 3  # of KITTI's, in half of the path; otherwise shares of the path are the lengths
_SHARES = (0.1, 0.2, 0.3, 0.4, 0.5)  # of the path (Zhang and Scaramuzza, IROS 2018)


def draw_errors(figure: Figure, curves: Sequence[Curve], _: Trajectory | None) -> None:
    """Draw absolute errors of position and rotation over the distance travelled."""
    figure.set_figheight(3.0)
    unit = common_unit(curves)
    panels = figure.subplots(2, 1, sharex=True)
    for axes, key, label in zip(
        panels, ("ape_trans", "ape_rot"), (f"position ({unit})", "rotation (deg)"), strict=True
    ):
        for curve in curves:
            if curve.evaluation is not None:
                error = curve.evaluation.errors[key]
                rmse = curve.evaluation.errors["ape_trans"].stats["rmse"]
                axes.plot(
                    error.np_arrays["distances_from_start"],
                    error.np_arrays["error_array"],
                    **curve.look.line,
                    label=f"{curve.name}: RMSE {rmse:.3g} {unit}",
                )
        axes.set_ylabel(f"error of\n{label}")
        axes.set_ylim(bottom=0)
    panels[-1].set_xlabel("travelled distance of the ground truth (m)")
    legend_below(figure, panels[0])


def draw_drift(figure: Figure, curves: Sequence[Curve], _: Trajectory | None) -> None:
    """Draw the spread of relative errors: from frame to frame, and of segments by their length."""
    shown = [curve for curve in curves if curve.evaluation is not None]
    figure.set_figheight(3.9)
    panels = figure.subplots(2, 2, width_ratios=(1, 3), sharex="col")
    lengths = segment_lengths(shown)
    segments = [_segments(curve, lengths) for curve in shown]
    for number, curve in enumerate(shown):
        for row, steps in enumerate(_from_frame_to_frame(curve)):
            _boxes(panels[row, 0], [steps], [number], 0.7, curve)
        places = [group + (number + 0.5) / len(shown) * 0.8 - 0.4 for group in range(len(lengths))]
        for row, errors in enumerate((segments[number].t_rel, segments[number].r_rel)):
            by_length = [errors[segments[number].lengths == length] for length in lengths]
            _boxes(panels[row, 1], by_length, places, 0.65 / len(shown), curve)
    unit, scaled = common_unit(curves), ", scale corrected" if any(curve.scale != 1 for curve in shown) else ""
    panels[0, 0].set(title="RPE from frame to frame", ylabel=f"position ({unit})")
    panels[1, 0].set(ylabel="rotation (deg)", xticks=[])
    panels[0, 1].set(title=f"drift over segments of the path{scaled}", ylabel="t_rel (%)")
    panels[1, 1].set(ylabel="r_rel (deg/100 m)", xlabel="length of the segment (m)")
    panels[1, 1].set_xticks(range(len(lengths)), [f"{length:.3g}" for length in lengths])
    for axes in panels.flat:
        axes.set_ylim(bottom=0)
        axes.grid(False, axis="x")
    legend_below(figure, panels[0, 0])


def segment_lengths(curves: Sequence[Curve]) -> NDArray[np.float64]:
    """Metres of the segments: KITTI's that half of the path holds, or shares of a path that is too short for them."""
    paths = [curve.evaluation.pairs.reference.path_length for curve in curves if curve.evaluation is not None]
    fitting = LENGTHS[max(paths) / 2 >= LENGTHS]
    return fitting if len(fitting) >= MIN_LENGTHS else np.array(_SHARES) * min(paths)


def _from_frame_to_frame(curve: Curve) -> list[NDArray[np.float64]]:
    """Relative errors of position and rotation (deg)."""
    assert curve.evaluation is not None
    return [curve.evaluation.errors[key].np_arrays["error_array"] for key in ("rpe_trans", "rpe_rot")]


def _segments(curve: Curve, lengths: NDArray[np.float64]) -> SegmentErrors:
    """The errors of the segments, in the scale of the alignment."""
    assert curve.evaluation is not None
    pairs = curve.evaluation.pairs
    estimate = pairs.estimate.matrices.copy()
    estimate[:, :3, 3] *= curve.scale
    return segment_errors(estimate, pairs.reference.matrices, lengths)


def _boxes(
    axes: Axes, values: Sequence[NDArray[np.float64]], places: Sequence[float], width: float, curve: Curve
) -> None:
    """Boxes of quartiles with whiskers from 5 to 95 %."""
    axes.boxplot(
        values,
        positions=places,
        widths=width,
        whis=(5, 95),
        showfliers=False,
        patch_artist=True,
        manage_ticks=False,
        boxprops={**curve.look.area, "linewidth": 0.6},
        medianprops={"color": "black", "linewidth": 1.4},
        whiskerprops={"linewidth": 0.6},
        capprops={"linewidth": 0.6},
        label=curve.name if len(values) == 1 else None,
    )
