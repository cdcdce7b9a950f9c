"""Interleave distance against accuracy, time and matches: how seldom V-SLAM may run (the paper, section 3)."""

import numpy as np
import typer
from experiments import Frames, Out, Preset, Seeds, SequencePath, column, run_variants, save
from matplotlib.figure import Figure
from one_sentence import one_sentence

from fvslam_graph.evaluation.plots.style import RUN_COLOURS
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.study.results import spread

DISTANCES = range(1, 11)
SHOWN = {"ape": "APE after Sim(3) (m)", "ms": "time (ms/frame, mean)", "matched": "matches per V-SLAM frame"}


def main(
    path: SequencePath,
    out: Out,
    preset: Preset = "tuned",
    mode: str = "average",
    frames: Frames = None,
    seeds: Seeds = 5,
) -> None:
    variants = {distance: (f"mode={mode}", f"slam.interleave={distance}") for distance in DISTANCES}
    groups = run_variants("interleave", variants, path, frames, preset, seeds, out)
    rows = [row for group in groups.values() for row in group]
    name = rows[0]["sequence"]

    caption = (
        f"{name}, preset {preset}, mode {mode}, scale by {rows[0]['scale_source']}, online, APE after Sim(3); median "
        f"and range over {seeds} seeds; ms: mean over frames without reading, one run on each core."
    )
    table = Table(
        ("interleave distance", "APE (m)", "t_rel (%)", "r_rel (deg/100 m)", "matches", "ms/frame"),
        [
            (
                f"{distance}",
                spread(column(group, "ape")),
                spread(column(group, "t_rel"), ".2f"),
                spread(column(group, "r_rel")),
                f"{np.median(column(group, 'matched')):.1f}",
                f"{np.median(column(group, 'ms')):.1f}",
            )
            for distance, group in groups.items()
        ],
        caption=caption,
    )

    def draw(figure: Figure) -> None:
        figure.suptitle(f"{name}, preset {preset}, mode {mode}, {seeds} seeds")
        for axes, (key, label) in zip(figure.subplots(1, len(SHOWN)), SHOWN.items(), strict=True):
            for distance, group in groups.items():
                axes.plot([distance] * seeds, column(group, key), ".", color=RUN_COLOURS[0], alpha=0.5)
            medians = [np.median(column(group, key)) for group in groups.values()]
            axes.plot(list(DISTANCES), medians, color=RUN_COLOURS[1])
            axes.set(xlabel="interleave distance", ylabel=label, ylim=(0, None))

    save(out, "interleave", f"{name}-{preset}", rows, table, draw, (11, 4))


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
