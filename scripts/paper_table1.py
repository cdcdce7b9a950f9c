"""The paper's Table 1: computing time against the number of features, for VO, V-SLAM on every frame, and both fused.

Times of another machine do not compare, ratios within a table do. Runs of all kinds take turns, so that no kind is
measured in a slow minute of the machine alone.
"""

import numpy as np
import typer
from experiments import Frames, Out, Preset, SequencePath, job_of, run_all, save
from matplotlib.figure import Figure
from one_sentence import one_sentence

from fvslam_graph.evaluation.plots.style import RUN_COLOURS
from fvslam_graph.evaluation.tables import Table

FEATURES = (15, 17, 19, 21, 23, 25)
MODES = {"vo": "VO", "vslam": "V-SLAM", "average": "ours"}
# Seconds for 200 frames of 1351x374 pixels, MATLAB, 2.6 GHz.
PAPER = {
    "vo": (14, 15, 15, 16, 16, 17),
    "vslam": (362, 437, 522, 615, 712, 830),
    "average": (155, 184, 218, 255, 296, 341),
}


def main(
    path: SequencePath,
    out: Out,
    preset: Preset = "tuned",
    frames: Frames = "0:200",
    repeat: int = 5,
) -> None:
    kinds = [(mode, count) for count in FEATURES for mode in MODES]
    jobs = [
        job_of(path, frames, preset, (f"mode={mode}", f"slam.min_landmarks={count}", f"seed={turn}"))
        for turn in range(repeat)
        for mode, count in kinds
    ]
    rows = run_all(jobs, out, workers=1)
    for row, (_, count) in zip(rows, kinds * repeat, strict=True):
        row["features"] = count
    measured = {mode: np.array([_median(rows, mode, count) for count in FEATURES]) for mode in MODES}
    paper = {mode: np.array(seconds) for mode, seconds in PAPER.items()}

    lines = []
    for label, times, unit in (("the paper", paper, "s"), ("measured", measured, "ms/frame")):
        for mode in MODES:
            lines.append((f"{label}: {MODES[mode]} ({unit})", *(f"{value:.4g}" for value in times[mode])))
        for name, (over, under) in {"ours / V-SLAM": ("average", "vslam"), "ours / VO": ("average", "vo")}.items():
            lines.append((f"{label}: {name}", *(f"{value:.2f}" for value in times[over] / times[under])))
        lines.append(
            (f"{label}: V-SLAM / V-SLAM(15)", *(f"{value:.2f}" for value in times["vslam"] / times["vslam"][0]))
        )
    name = rows[0]["sequence"]
    caption = (
        f"{name}, frames {frames}, preset {preset}; measured: mean over the frames without reading, median of "
        f"{repeat} runs taken in turn. The number of features is that of V-SLAM's landmarks; VO keeps its own."
    )
    table = Table(("number of features", *map(str, FEATURES)), lines, caption=caption)

    def draw(figure: Figure) -> None:
        figure.suptitle("computing time relative to VO with 15 features")
        for axes, (title, times) in zip(
            figure.subplots(1, 2), {"the paper": paper, f"{name}, preset {preset}": measured}.items(), strict=True
        ):
            for mode, colour in zip(MODES, RUN_COLOURS, strict=False):
                axes.plot(FEATURES, times[mode] / times["vo"][0], "o-", color=colour, label=MODES[mode])
            axes.set(title=title, xlabel="number of features", ylim=(0, None))
            axes.legend()

    save(out, "table1", f"{name}-{preset}", rows, table, draw, (9, 4))


def _median(rows: list[dict[str, object]], mode: str, count: int) -> float:
    return float(np.median([row["ms"] for row in rows if row["mode"] == mode and row["features"] == count]))


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
