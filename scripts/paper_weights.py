"""The paper's claim that fifty-fifty is best: fusion weight of V-SLAM, from 0 to 1, against APE and drift."""

import typer
from experiments import Frames, Out, Preset, Seeds, SequencePath, column, run_variants, save
from matplotlib.figure import Figure
from one_sentence import one_sentence

from fvslam_graph.evaluation.plots.style import RUN_COLOURS
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.study.results import spread

WEIGHTS = [round(0.1 * step, 1) for step in range(11)]


def main(path: SequencePath, out: Out, preset: Preset = "tuned", frames: Frames = None, seeds: Seeds = 5) -> None:
    variants = {weight: ("mode=average", f"fusion.weight={weight}") for weight in WEIGHTS}
    groups = run_variants("weight", variants, path, frames, preset, seeds, out)
    rows = [row for group in groups.values() for row in group]
    name = rows[0]["sequence"]

    caption = (
        f"{name}, preset {preset}, mode average, scale by {rows[0]['scale_source']}, online, APE after Sim(3); "
        f"median and range over {seeds} seeds."
    )
    table = Table(
        ("weight of V-SLAM", "APE (m)", "t_rel (%)", "r_rel (deg/100 m)"),
        [
            (
                f"{weight}",
                spread(column(group, "ape")),
                spread(column(group, "t_rel"), ".2f"),
                spread(column(group, "r_rel")),
            )
            for weight, group in groups.items()
        ],
        caption=caption,
    )

    def draw(figure: Figure) -> None:
        figure.suptitle(f"{name}, preset {preset}: weight of V-SLAM in the mean, {seeds} seeds")
        for axes, key, label in zip(
            figure.subplots(1, 2), ("ape", "rpe"), ("APE after Sim(3) (m)", "RPE from frame to frame (m)"), strict=True
        ):
            values = [column(group, key) for group in groups.values()]
            for weight, several in zip(WEIGHTS, values, strict=True):
                axes.plot([weight] * len(several), several, ".", color=RUN_COLOURS[0], alpha=0.5)
            axes.plot(WEIGHTS, [float(sorted(several)[len(several) // 2]) for several in values], color=RUN_COLOURS[1])
            axes.set(xlabel="weight of V-SLAM", ylabel=label, ylim=(0, None))

    save(out, "weights", f"{name}-{preset}", rows, table, draw, (9, 4))


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
