"""A picture of what a calibration leaves over: residuals of the corners of a board."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fvslam_graph.core.files import writing
from fvslam_graph.evaluation.plots.style import RUN_COLOURS, STYLE, save
from fvslam_graph.sequences.board_calibration import BoardCalibration

ARROW = 0.03  # of the image's width, length of an arrow as long as the root mean square


def plot_residuals(calibration: BoardCalibration, path: Path) -> None:
    """Draw residuals where they are in the image, and against each other; `path` is a PNG file.

    Arrows that turn alike in a part of the image say that the lens model does not describe it.
    """
    import matplotlib
    from matplotlib.figure import Figure

    camera = calibration.camera
    pixels = np.concatenate([view.pixels for view in calibration.views])
    residuals = np.concatenate(calibration.residuals)
    with writing(path.parent), matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12, 5), layout="constrained")
        image, scatter = figure.subplots(1, 2, width_ratios=(3, 2))
        scale = calibration.rms / (ARROW * camera.width)
        image.quiver(*pixels.T, *residuals.T, angles="xy", scale_units="xy", scale=scale, color=RUN_COLOURS[0])
        image.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), aspect="equal")
        image.set_title(f"residuals, {1 / scale:.0f} times as long as they are", fontsize=9)
        scatter.plot(*residuals.T, ".", color=RUN_COLOURS[0], markersize=3)
        limit = 1.05 * float(np.abs(residuals).max())
        scatter.set(xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal")
        scatter.set(xlabel="right (pixels)", ylabel="down (pixels)")
        views = f"{len(calibration.views)} views, {len(pixels)} corners"
        scatter.set_title(f"{views}, {calibration.rms:.3f} pixels root mean square", fontsize=9)
        save(figure, path.with_suffix(""), (path.suffix,))
