"""Plots of what visual SLAM saw in a frame: the image with its landmarks, and the map from above."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.extras import require
from fvslam_graph.core.files import writing
from fvslam_graph.core.gates import chi2_gate
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.evaluation.plots.covariance import ellipse
from fvslam_graph.evaluation.plots.runs import level_axes
from fvslam_graph.evaluation.plots.style import PAGE_WIDTH, STYLE, legend_below, legible, save
from fvslam_graph.runs.frame_files import LANDMARKS
from fvslam_graph.runs.landmark_table import NEW, landmark_frames, landmark_points, read_landmarks
from fvslam_graph.runs.ownership import INFO, claim_files
from fvslam_graph.runs.results import Run
from fvslam_graph.runs.run_folder import read_run
from fvslam_graph.sequences.open import open_sequence

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OUTCOMES = {  # colour, marker, name
    "inlier": ("#D55E00", "o", "inlier"),
    "rescued": ("#E69F00", "s", "rescued inlier"),
    "rejected": ("#CC79A7", "X", "rejected"),
    "unmatched": ("#0072B2", "P", "unmatched"),
    NEW: ("#009E73", "^", "new"),
}
SEARCHED_SIGMAS = chi2_gate(0.99, 2) ** 0.5  # of the ellipses in the image: 99 %, what is searched
_SHOWN_PERCENT = 95  # percent of the landmarks that the map shows


def plot_landmarks(folder: Path, frames: list[int], out: Path) -> list[Path]:
    """Draw frames of a run with landmarks, as PNG; the recording is opened where it was when it ran.

    Args:
        folder: Of a run with visual SLAM.
        frames: Wanted; of each, the nearest on which visual SLAM ran is drawn.
        out: Folder for the figures.

    Raises:
        FvslamError: The run has no landmarks or no such frame, or the recording is not there any more.
    """
    require("eval")
    import matplotlib
    from matplotlib.figure import Figure

    run = read_run(folder)
    table = folder / LANDMARKS
    if not table.exists():
        raise ResultsError(f"{folder} has no landmarks to show; run it with visual SLAM, as by --mode vslam")
    sequence = recording_of(folder, run)
    down = np.array(run.info.get("down") or (0.0, 1.0, 0.0))
    files = []
    shown = _with_landmarks(table, frames, len(run.online))
    with writing(out), matplotlib.rc_context(STYLE):
        claim_files(out, [f"plot_landmarks_{frame:06d}.png" for frame in shown])
        for frame, landmarks in shown.items():
            image = sequence.frame(frame).image
            figure = Figure(figsize=(PAGE_WIDTH, 6), layout="constrained")
            above, below = figure.subplots(2, 1, height_ratios=(3, 2))
            status, mode = run.frames["status"][frame], run.info.get("mode")
            figure.suptitle(f"{legible(sequence.name)}, frame {frame}: {status}, {mode}")
            if image is not None:
                above.imshow(image, cmap="gray", vmin=0, vmax=255)
            _draw_image(above, landmarks, (sequence.camera.width, sequence.camera.height))
            _draw_map(below, landmarks, level_axes(down))
            legend_below(figure, above)
            files += save(figure, out / f"plot_landmarks_{frame:06d}", (".png",))
    return files


def recording_of(folder: Path, run: Run) -> Sequence:
    """The recording that a run is of, opened again where it was when it ran.

    Raises:
        FvslamError: It is not there any more, or the run does not know it.
    """
    source = run.info.get("source")
    if source is None:
        raise ResultsError(f"{folder / INFO} does not know the recording, which was changed after it was opened")
    try:
        return open_sequence(**source)
    except (TypeError, ValueError, AttributeError):
        raise ResultsError(f"{folder / INFO} does not say how to open the recording; run it again") from None


def _with_landmarks(table: Path, frames: list[int], count: int) -> dict[int, dict[str, NDArray[Any]]]:
    """The nearest frames on which visual SLAM ran, with their landmarks, of a run of `count` frames."""
    try:
        there = landmark_frames(table)
        there = there[there < count]
        for frame in frames:
            if not (0 <= frame < count and len(there)):
                raise ResultsError(f"{table.parent} has no frame {frame} with landmarks; it has {count} frames, from 0")
        nearest = sorted({int(there[np.abs(there - frame).argmin()]) for frame in frames})
        return {frame: read_landmarks(table, frame) for frame in nearest}
    except ValueError as error:
        raise ResultsError(f"{table} cannot be read, the run must be done again: {error}") from None


def _draw_image(axes: Axes, landmarks: dict[str, NDArray[Any]], size: tuple[int, int]) -> None:
    """Ellipses where landmarks were looked for, dots where they were found."""
    from matplotlib.patches import Ellipse

    for outcome, (colour, marker, label) in OUTCOMES.items():
        chosen = landmarks["outcome"] == outcome
        u, v = landmarks["u"][chosen], landmarks["v"][chosen]
        axes.plot(u, v, marker, color=colour, markersize=3, label=f"{label} ({chosen.sum()})")
        for expected_u, expected_v, uu, uv, vv in zip(
            *(
                landmarks[name][chosen]
                for name in ("expected_u", "expected_v", "ellipse_uu", "ellipse_uv", "ellipse_vv")
            ),
            strict=True,
        ):
            if np.isfinite(expected_u):
                width, height, angle = ellipse(np.array([[uu, uv], [uv, vv]]), SEARCHED_SIGMAS)
                axes.add_patch(Ellipse((expected_u, expected_v), width, height, angle=angle, fill=False, color=colour))
    axes.set(xlim=(-0.5, size[0] - 0.5), ylim=(size[1] - 0.5, -0.5), xticks=[], yticks=[])
    axes.set_title("ellipses: where landmarks were searched (99 %); dots: where they were found")
    axes.grid(False)


def _draw_map(axes: Axes, landmarks: dict[str, NDArray[Any]], level: NDArray[np.float64]) -> None:
    """Landmarks from above with their uncertainty; the camera is at the origin."""
    from matplotlib.patches import Ellipse

    points, covariances = landmark_points(landmarks)
    ground = level[:2] @ points.T
    spreads = level[:2] @ covariances @ level[:2].T
    for outcome, (colour, marker, _) in OUTCOMES.items():
        for n in np.flatnonzero((landmarks["outcome"] == outcome) & np.isfinite(points[:, 0])):
            width, height, angle = ellipse(spreads[n], 2.0)
            axes.add_patch(Ellipse(ground[:, n], width, height, angle=angle, color=colour, alpha=0.4, linewidth=1))
            axes.plot(*ground[:, n], marker, color=colour, markersize=3)
    axes.plot(0, 0, "^", color="black", markersize=8)
    # Landmarks far away, and their uncertainty, would make the rest too small to see.
    seen = ground[:, np.isfinite(ground[0])] if np.isfinite(ground).any() else np.array([[-1.0, 1.0], [0.0, 1.0]])
    low, high = np.percentile(seen[1], [100 - _SHOWN_PERCENT, _SHOWN_PERCENT])
    low, high = min(low, 0.0) - 1, max(high, 0.0) + 1
    aside = max(float(np.percentile(np.abs(seen[0]), _SHOWN_PERCENT)), 1.2 * (high - low))
    axes.set(xlim=(-aside, aside), ylim=(low, high))
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlabel="right (m)", ylabel="forward (m)", title="the map from above, ellipses of two standard deviations")
