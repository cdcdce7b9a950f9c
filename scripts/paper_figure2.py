"""The paper's Fig. 2: an image with matched and unmatched features, and the trajectories of VO, V-SLAM and both fused.

Trajectories are those known online, brought to the ground truth by Sim(3), from above, on equal axes.
"""

from typing import Annotated

import numpy as np
import typer
from experiments import Frames, Out, Preset, SequencePath, save
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from one_sentence import one_sentence

from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.core.slam_estimate import MatchOutcome
from fvslam_graph.estimator import estimate
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.plots.runs import level_axes
from fvslam_graph.evaluation.plots.style import RUN_COLOURS, TRUTH
from fvslam_graph.evaluation.runs import evaluation_of
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.pipeline import resolve_config, run_metadata
from fvslam_graph.runs.results import collect
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.study.jobs import metric_columns

MODES = {"vo": "VO", "vslam": "V-SLAM", "average": "our approach"}
KINDS = {  # the paper's colours
    "matched inliers": ("red", (MatchOutcome.INLIER, MatchOutcome.RESCUED)),
    "matched outliers": ("magenta", (MatchOutcome.REJECTED,)),
    "unmatched": ("blue", (MatchOutcome.UNMATCHED,)),
}


def main(
    path: SequencePath,
    out: Out,
    preset: Preset = "tuned",
    frames: Frames = None,
    seed: int = 0,
    shown: Annotated[int | None, typer.Option(help="Frame that the image shows; from the middle by itself.")] = None,
) -> None:
    sequence = open_sequence(path, frames=frames)
    if sequence.ground_truth is None:
        raise FvslamError(f"{sequence.name} has no ground truth to compare with")
    runs, evaluations = {}, {}
    for mode in MODES:
        config = resolve_config(load_config(preset, settings=[f"mode={mode}", f"seed={seed}"]), sequence)
        runs[mode] = list(estimate(sequence, config))
        run = collect(runs[mode], config, run_metadata(sequence, config), sequence.ground_truth)
        evaluations[mode] = evaluation_of(run, align=Alignment.SIM3)
    searched = {r.index: r.slam.matches for r in runs["average"] if r.slam is not None and len(r.slam.matches)}
    middle = len(sequence) // 2 if shown is None else shown
    index = min(searched, key=lambda frame: abs(frame - middle))

    down = run_metadata(sequence, config)["down"]
    level = level_axes(np.array((0.0, 1.0, 0.0) if down is None else down))
    start = evaluations["vo"].pairs.reference.poses[0].inverse().matrix()

    def from_above(positions: NDArray[np.float64]) -> NDArray[np.float64]:
        seen: NDArray[np.float64] = (positions @ start[:3, :3].T + start[:3, 3]) @ level[:2].T
        return seen

    def draw_image(axes: Axes) -> None:
        image = sequence.frame(index).image
        if image is not None:
            axes.imshow(image, cmap="gray", vmin=0, vmax=255)
        seen = searched[index]
        pixels = np.where(np.isnan(seen.pixels), seen.expected, seen.pixels)
        for label, (colour, outcomes) in KINDS.items():
            chosen = pixels[np.isin(seen.outcome, outcomes)]
            axes.plot(*chosen.T, "o", color=colour, markersize=4, label=f"{label}: {len(chosen)}")
        axes.set(xlim=(0, sequence.camera.width), ylim=(sequence.camera.height, 0), title=f"frame {index}")
        axes.set_axis_off()
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=3)

    def draw(figure: Figure) -> None:
        figure.suptitle(f"{sequence.name}, preset {preset}, scale by {config.scale.source}, aligned by Sim(3)")
        first, *panels = figure.subplots(2, 2).ravel()
        draw_image(first)
        for axes, (mode, label), colour in zip(panels, MODES.items(), RUN_COLOURS, strict=False):
            error = evaluations[mode].errors["ape_trans"]
            axes.plot(*from_above(evaluations[mode].pairs.reference.positions).T, **TRUTH)
            axes.plot(
                *from_above(error.trajectories[evaluations[mode].name].positions_xyz).T, color=colour, label=label
            )
            axes.set(title=f"{label}: APE {error.stats['rmse']:.3g} m", xlabel="right (m)", ylabel="forward (m)")
            axes.set_aspect("equal", adjustable="datalim")
            axes.legend()

    rows = [{"sequence": sequence.name, "mode": mode, **metric_columns(evaluations[mode])} for mode in MODES]
    caption = f"{sequence.name}, preset {preset}, scale by {config.scale.source}, online, Sim(3), seed {seed}."
    table = Table(
        ("mode", "APE (m)", "RPE (m)", "t_rel (%)", "r_rel (deg/100 m)"),
        [(MODES[str(r["mode"])], *(f"{r[key]:.3f}" for key in ("ape", "rpe", "t_rel", "r_rel"))) for r in rows],
        caption=caption,
    )
    save(out, "figure2", f"{sequence.name}-{preset}", rows, table, draw, (12, 9))


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
