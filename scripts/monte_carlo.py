"""Monte-Carlo consistency on simulated points: NEES of the pose over many seeds, without images.

Each seed is a scene of its own, with noise of half a pixel. The mean NEES over the seeds is compared, frame by frame,
with the band in which the mean of as many consistent estimates lies with 95 % probability (Bar-Shalom, Li, Kirubarajan
2001, section 5.4.2).

`nees_vslam.png` is visual SLAM that starts from depths whose errors are known, without and with a share of wrong
matches; the error of the position is compared, too. `nees_modes.png` is all modes as they run on images. Points have no
ground to measure: the length of each baseline is the true one, with the error that the scale source `oracle` states.
"""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from matplotlib.figure import Figure
from numpy.typing import NDArray
from one_sentence import one_sentence
from pages import save_table

from fvslam_graph.core.choices import Mode
from fvslam_graph.core.config import SlamSettings, load_config
from fvslam_graph.evaluation.monte_carlo import pose_errors, run, run_vslam
from fvslam_graph.evaluation.nees import average_nees, nees
from fvslam_graph.evaluation.plots.style import RUN_COLOURS, STYLE
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.simulation.points import simulate_drive, simulate_flight

SCENES = {"drive": simulate_drive, "flight": simulate_flight}
NOISE = 0.5  # pixels
LANDMARKS = 6000
# What the settings say of noise is made for trackers on images, which err by 0.1 to 0.2 pixels.
SETTINGS = (
    "scale.source=oracle",
    f"slam.pixel_sigma={NOISE}",
    f"graph.pixel_sigma={NOISE}",
    f"vo.ransac_threshold={2 * NOISE}",
    "graph.common_noise=0",  # points err each on its own,
    "graph.shared_pixels=exclude",  # so that landmarks weigh as much as odometry's tracks
)

Errors = tuple[NDArray[np.float64], NDArray[np.float64]]
"""NEES and position errors (m) of each frame after the first two, (frames,) each."""


def known_start(wrong: float, kind: str, frames: int, seed: int) -> Errors:
    """Visual SLAM that starts from known depths, with a share of wrong matches."""
    scene = SCENES[kind](frames=frames + 2, seed=seed, noise=NOISE, landmarks=LANDMARKS)
    estimates = list(run_vslam(scene, SlamSettings(pixel_sigma=NOISE), seed, wrong))[1:]
    return _errors(*pose_errors(scene, estimates))


def whole_mode(mode: Mode, kind: str, frames: int, seed: int) -> Errors:
    """Any mode, as it runs on images."""
    scene = SCENES[kind](frames=frames + 2, seed=seed, noise=NOISE, landmarks=LANDMARKS)
    config = load_config(settings=[f"mode={mode}", f"seed={seed}", *SETTINGS])
    errors, covariances = pose_errors(scene, run(scene, config))
    return _errors(errors[2:], covariances[2:])


def main(
    out: Annotated[Path, typer.Option(help="Folder of the figures.")] = Path("runs") / "monte_carlo",
    seeds: int = 50,
    frames: int = 100,
    wrong: Annotated[float, typer.Option(help="Share of wrong matches in the second half of the runs.")] = 0.5,
) -> None:
    import matplotlib

    out.mkdir(parents=True, exist_ok=True)
    rows = []
    starts = {f"{100 * share:.0f} % wrong matches": partial(known_start, share) for share in (0.0, wrong)}
    modes = {mode.value: partial(whole_mode, mode) for mode in Mode}
    with matplotlib.rc_context(STYLE), ProcessPoolExecutor() as pool:
        for file, title, kinds in (
            ("nees_vslam.png", "V-SLAM from known depths", starts),
            ("nees_modes.png", "all modes, scale source oracle", modes),
        ):
            figure = Figure(figsize=(9, 6), layout="constrained")
            figure.suptitle(f"{title}, {NOISE} pixels of noise: NEES of the pose, mean of {seeds} seeds")
            for axes, kind in zip(figure.subplots(len(SCENES), 1, sharex=True), SCENES, strict=True):
                for colour, (label, values, errors) in zip(
                    RUN_COLOURS, _runs(pool, kinds, kind, frames, seeds), strict=False
                ):
                    steps, (low, high) = average_nees(values)
                    inside = 100 * np.mean((steps >= low) & (steps <= high))
                    position = float(np.sqrt((errors**2).mean()))
                    print(
                        f"{kind}, {label}: mean NEES {values.mean():.2f}, median of a run {_median(values):.2f}, "
                        f"95 % band over {seeds} seeds [{low:.2f}, {high:.2f}], {inside:.0f} % of {frames} frames "
                        f"inside; position off by {position:.3f} m (RMS)"
                    )
                    rows.append([label, kind, f"{values.mean():.1f}", f"{inside:.0f}", f"{position:.3f}"])
                    axes.plot(np.arange(1, frames + 1), steps, color=colour, label=label)
                axes.axhspan(
                    low, high, color="grey", alpha=0.25, linewidth=0, label="95 % band of consistent estimates"
                )
                axes.set(title=kind, ylabel="mean NEES", yscale="log", ylim=(1, None))
            axes.set_xlabel("frame")
            figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
            figure.savefig(out / file)
            print(out / file)
    columns = ("estimator", "scene", "mean NEES", "frames within (%)", "RMS of the position (m)")
    save_table(out, "monte-carlo", Table(columns, rows, words=2, keys=2))


def _runs(
    pool: ProcessPoolExecutor,
    kinds: Mapping[str, Callable[[str, int, int], Errors]],
    kind: str,
    frames: int,
    seeds: int,
) -> Iterator[tuple[str, NDArray[np.float64], NDArray[np.float64]]]:
    """Label, NEES and position errors (seeds, frames) of each kind of run."""
    for label, one in kinds.items():
        jobs = [pool.submit(one, kind, frames, seed) for seed in range(seeds)]
        values, errors = (np.array(part) for part in zip(*(job.result() for job in jobs), strict=True))
        yield label, values, errors


def _errors(errors: NDArray[np.float64], covariances: NDArray[np.float64]) -> Errors:
    return nees(errors, covariances)[0], np.linalg.norm(errors[:, 3:], axis=1)


def _median(values: NDArray[np.float64]) -> float:
    return float(np.median(values.mean(axis=1)))


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
