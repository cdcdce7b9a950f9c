"""All modes on one sequence, and what each choice in the factor graph contributes: one row a variant, over seeds."""

import numpy as np
import typer
from experiments import Frames, Out, Preset, Seeds, SequencePath, column, run_variants, save
from matplotlib.figure import Figure
from one_sentence import one_sentence

from fvslam_graph.core.choices import Mode
from fvslam_graph.evaluation.plots.style import RUN_COLOURS
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.study.results import spread

MODES = {mode.value: (f"mode={mode}",) for mode in Mode}
GRAPH = {
    "odometry as essential matrix and length": ("graph.odometry=essential",),
    "landmarks as bearing and range": ("graph.landmarks=bearing_range",),
    "landmarks as smart factors": ("graph.landmarks=smart",),
    "no landmarks": ("graph.landmarks=none",),
    "Huber's kernel": ("graph.kernel=huber", "graph.kernel_width=1.345"),
    "no kernel": ("graph.kernel=none",),
    "lengths independent of each other": ("graph.scale_model=independent",),
    "landmarks that err each on its own": ("graph.common_noise=0",),
    "pixels counted twice": ("graph.shared_pixels=ignore",),
    "tracks of landmarks left out of odometry": ("graph.shared_pixels=exclude",),
    "odometry deflated by 2": ("graph.deflation=2",),
    "no alignment with reference patches": ("slam.alignment=false",),
    "any zoom": ("graph.max_zoom=100",),
    "25 landmarks": ("slam.min_landmarks=25",),
    "k = 1": ("slam.interleave=1",),
    "k = 2": ("slam.interleave=2",),
    "k = 10": ("slam.interleave=10",),
    "online: where the graph has the camera": ("graph.online=latest",),
}
VARIANTS = MODES | {f"graph, {name}": ("mode=graph", *settings) for name, settings in GRAPH.items()}


def main(path: SequencePath, out: Out, preset: Preset = "tuned", frames: Frames = None, seeds: Seeds = 5) -> None:
    groups = run_variants("variant", VARIANTS, path, frames, preset, seeds, out)
    rows = [row for group in groups.values() for row in group]
    name = rows[0]["sequence"]

    caption = (
        f"{name}, preset {preset}, scale by {rows[0]['scale_source']}, online unless it says smoothed, APE after "
        f"Sim(3); median (range) over {seeds} seeds; ms: mean over frames without reading, one run on each core."
    )
    table = Table(
        ("variant", "APE (m)", "smoothed", "t_rel (%)", "r_rel (deg/100 m)", "ms/frame"),
        [
            (
                variant,
                spread(column(group, "ape")),
                spread(column(group, "ape_smoothed")),
                f"{np.median(column(group, 't_rel')):.2f}",
                f"{np.median(column(group, 'r_rel')):.3f}",
                f"{np.median(column(group, 'ms')):.0f}",
            )
            for variant, group in groups.items()
        ],
        caption=caption,
    )

    def draw(figure: Figure) -> None:
        figure.suptitle(f"{name}, preset {preset}, {seeds} seeds")
        axes = figure.subplots()
        for row, group in enumerate(groups.values()):
            colour = RUN_COLOURS[0 if row < len(MODES) else 1]
            axes.plot(column(group, "ape"), [row] * seeds, ".", color=colour, alpha=0.5)
            axes.plot(np.median(column(group, "ape")), row, "|", color=colour, markersize=14)
        axes.set(yticks=range(len(groups)), yticklabels=list(groups), xlabel="APE after Sim(3) (m)", xscale="log")
        axes.invert_yaxis()

    save(out, "ablation", f"{name}-{preset}", rows, table, draw, (9, 7))


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
