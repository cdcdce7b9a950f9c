"""Monte-Carlo consistency of visual odometry: NEES of relative poses over many seeds of a synthetic world.

Each seed is a world of its own. The mean NEES over the seeds is compared, frame by frame, with the band in which the
mean of as many consistent estimates lies with 95 % probability (Bar-Shalom, Li, Kirubarajan 2001, section 5.4.2).
"""

from concurrent.futures import ProcessPoolExecutor
from typing import Annotated

import cv2
import gtsam
import numpy as np
import typer
from numpy.typing import NDArray
from one_sentence import one_sentence

from fvslam_graph.core.config import load_config
from fvslam_graph.core.trajectory import Status
from fvslam_graph.estimator import estimate
from fvslam_graph.evaluation.nees import average_nees
from fvslam_graph.sequences.open import open_sequence

PARTS = {"pose": slice(0, 6), "rotation": slice(0, 3), "translation": slice(3, 6)}


def run_seed(world: str, seed: int, preset: str, settings: list[str]) -> NDArray[np.float64]:
    """NEES (frames, 3) of whole poses, rotations and translations; NaN for frames that were not tracked."""
    cv2.setNumThreads(1)
    sequence = open_sequence(f"{world}{'&' if '?' in world else '?'}seed={seed}")
    truth = sequence.ground_truth
    assert truth is not None
    values = np.full((len(sequence), len(PARTS)), np.nan)
    for result in estimate(sequence, load_config(preset, settings=[f"seed={seed}", *settings])):
        if result.status is not Status.TRACKED:
            continue
        true_relative = truth.poses[result.previous].between(truth.poses[result.index])
        error = gtsam.Pose3.Logmap(result.relative.mean.between(true_relative))
        covariance = result.relative.covariance
        for column, part in enumerate(PARTS.values()):
            values[result.index, column] = error[part] @ np.linalg.solve(covariance[part, part], error[part])
    return values


def main(
    worlds: Annotated[list[str], typer.Argument(help="synthetic:uav, synthetic:drive, with options.")],
    seeds: int = 20,
    preset: str = "tuned",
    settings: Annotated[list[str] | None, typer.Option("--set")] = None,
) -> None:
    for world in worlds:
        with ProcessPoolExecutor() as pool:
            jobs = [pool.submit(run_seed, world, seed, preset, settings or []) for seed in range(seeds)]
            runs = np.array([job.result() for job in jobs])
        print(f"{world}: {seeds} seeds, {np.isfinite(runs[..., 0]).sum()} tracked frames")
        for column, (name, part) in enumerate(PARTS.items()):
            values = runs[..., column]
            complete = values[:, np.isfinite(values).all(axis=0)]
            steps, (low, high) = average_nees(complete, part.stop - part.start)
            inside = np.mean((steps >= low) & (steps <= high))
            print(
                f"  {name:11} mean NEES {np.nanmean(values):6.2f}, median {np.nanmedian(values):6.2f}, "
                f"95 % band [{low:.2f}, {high:.2f}] of the mean over seeds, {100 * inside:.0f} % of frames inside"
            )


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
