"""Monte-Carlo consistency on simulated points: NEES of the pose over many seeds, without images.

Each seed is a scene of its own, with noise of half a pixel. The mean NEES over the seeds is compared, frame by frame,
with the band in which the mean of as many honest estimates lies with 95 % probability (Bar-Shalom, Li, Kirubarajan
2001, section 5.4.2). With a share of wrong matches, the error of the position is compared with the one without.
"""

from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fvslam_graph.config import SlamSettings
from fvslam_graph.evaluation.nees import average_nees, nees
from fvslam_graph.evaluation.plots import RUN_COLOURS, STYLE
from fvslam_graph.monte_carlo import pose_errors, run_vslam
from fvslam_graph.sequences.points import simulate_drive, simulate_flight

SCENES = {"drive": simulate_drive, "flight": simulate_flight}
NOISE = 0.5  # pixels
LANDMARKS = 6000


def run_seed(kind: str, seed: int, frames: int, wrong: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """NEES and position errors (m) of each frame after the first two, (frames,) each."""
    scene = SCENES[kind](frames=frames + 2, seed=seed, noise=NOISE, landmarks=LANDMARKS)
    estimates = list(run_vslam(scene, SlamSettings(pixel_sigma=NOISE), seed, wrong))[1:]
    errors, covariances = pose_errors(scene, estimates)
    return nees(errors, covariances)[0], np.linalg.norm(errors[:, 3:], axis=1)


def main(
    out: Annotated[Path, typer.Option(help="Folder of the figure.")] = Path("runs") / "monte_carlo",
    seeds: int = 50,
    frames: int = 100,
    wrong: Annotated[float, typer.Option(help="Share of wrong matches in the second half of the runs.")] = 0.5,
) -> None:
    import matplotlib

    out.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(STYLE), ProcessPoolExecutor() as pool:
        figure = Figure(figsize=(9, 6), layout="constrained")
        figure.suptitle(f"V-SLAM on simulated points, {NOISE} pixels of noise: NEES of the pose, mean of {seeds} seeds")
        for axes, kind in zip(figure.subplots(len(SCENES), 1, sharex=True), SCENES, strict=True):
            off = {}
            for share, colour in ((0.0, RUN_COLOURS[0]), (wrong, RUN_COLOURS[1])):
                jobs = [pool.submit(run_seed, kind, seed, frames, share) for seed in range(seeds)]
                values, errors = (np.array(part) for part in zip(*(job.result() for job in jobs), strict=True))
                steps, (low, high) = average_nees(values)
                off[share] = float(np.sqrt((errors**2).mean()))
                inside = 100 * np.mean((steps >= low) & (steps <= high))
                print(
                    f"{kind}, {100 * share:.0f} % wrong matches: mean NEES {values.mean():.2f}, 95 % band of the mean "
                    f"over {seeds} seeds [{low:.2f}, {high:.2f}], {inside:.0f} % of {frames} frames inside; "
                    f"position off by {off[share]:.2f} m (RMS), {off[share] / off[0.0]:.2f} of that without"
                )
                axes.plot(np.arange(1, frames + 1), steps, color=colour, label=f"{100 * share:.0f} % wrong matches")
            axes.axhspan(low, high, color="grey", alpha=0.25, linewidth=0, label="95 % band of honest estimates")
            axes.set(title=kind, ylabel="mean NEES", ylim=(0, None))
        axes.set_xlabel("frame")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
        figure.savefig(out / "nees_vslam.png")
    print(out / "nees_vslam.png")


if __name__ == "__main__":
    typer.run(main)
