"""Measure what becomes of the pose and of its covariance when something is wrong in the middle of a recording.

Poses are taken relative to the frame before the disturbance, so that earlier drift does not count, and in the scale
that the path had up to there where nothing tells metres. Sigma is the deviation of the position in its most uncertain
direction. The pose has recovered where motions over some frames err by no more than undisturbed ones do.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import gtsam
import numpy as np
import typer
from numpy.typing import NDArray
from one_sentence import one_sentence

from fvslam_graph.core.config import load_config
from fvslam_graph.core.frame_result import FrameResult
from fvslam_graph.estimator import estimate
from fvslam_graph.pipeline import resolve_config
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.simulation.disturbed import DISTURBANCES, Disturbed

SPAN = 5  # frames over which a motion is measured
RECOVERED = 0.2  # of the length of such a motion that it may err by


@dataclass(frozen=True)
class Row:
    """How one disturbance went.

    Attributes:
        error: (N,) metres, of each frame's position; NaN before the disturbance and where there is no ground truth.
        sigma: (N,) metres, what the estimate says of it.
        recovered: Frames after the disturbance until motions are right again for good; None where they never are.
    """

    error: NDArray[np.float64]
    sigma: NDArray[np.float64]
    recovered: int | None

    def inside(self, frames: slice) -> float:
        """Share of these frames whose error is within three sigma."""
        error, sigma = self.error[frames], self.sigma[frames]
        known = np.isfinite(error)
        return float(np.mean(error[known] <= 3 * sigma[known])) if known.any() else float("nan")


def judge(disturbed: Disturbed, results: list[FrameResult], relative: bool) -> Row:
    """Hold a run against the ground truth of what it has seen; `relative` where nothing tells metres."""
    truth = disturbed.sequence.ground_truth
    assert truth is not None
    known = truth.interpolate(disturbed.sequence.stamps)
    there = np.flatnonzero(np.isin(disturbed.sequence.stamps, known.stamps))
    true = dict(zip(there.tolist(), known.poses, strict=True))
    start = max(k for k in true if k < disturbed.first)
    scale = _scale(true, results, start) if relative else 1.0

    error, sigma = np.full((2, len(results)), np.nan)
    motion_error = np.full(len(results), np.nan)
    origin = results[start].pose
    for k in (k for k in true if k > start):
        pose = results[k].pose
        moved, truly = origin.mean.between(pose.mean), true[start].between(true[k])
        error[k] = np.linalg.norm(scale * moved.translation() - truly.translation())
        adjoint = moved.inverse().AdjointMap()
        since = (pose.covariance - adjoint @ origin.covariance @ adjoint.T)[3:, 3:]
        sigma[k] = scale * np.sqrt(max(np.linalg.eigvalsh(since)[-1], 0.0))
        if k - SPAN in true:
            moved = scale * results[k - SPAN].pose.mean.between(pose.mean).translation()
            truly = true[k - SPAN].between(true[k]).translation()
            motion_error[k] = np.linalg.norm(moved - truly) / max(float(np.linalg.norm(truly)), 1e-9)
    bad = np.flatnonzero(motion_error > RECOVERED)
    wrong_until = int(bad[-1]) + 1 - SPAN if len(bad) else disturbed.after
    recovered = max(wrong_until - disturbed.after, 0)
    return Row(error, sigma, recovered if wrong_until + SPAN < len(results) else None)


def _scale(true: dict[int, gtsam.Pose3], results: list[FrameResult], last: int) -> float:
    """Metres per unit of the estimate, by the spread of the positions up to frame `last`."""
    frames = [k for k in true if k <= last]
    spread = [
        np.std([pose.translation() for pose in poses], axis=0)
        for poses in ([true[k] for k in frames], [results[k].pose.mean for k in frames])
    ]
    return float(np.linalg.norm(spread[0]) / max(float(np.linalg.norm(spread[1])), 1e-9))


def main(
    recording: Path,
    mode: str = "vo",
    seed: int = 0,
    frames: Annotated[str, typer.Option(help="START:STOP, the part that is used.")] = ":",
    at: Annotated[float, typer.Option(help="Where the disturbance begins, as a share of the frames.")] = 0.4,
    only: Annotated[list[str] | None, typer.Option(help=f"Any of {', '.join(DISTURBANCES)}.")] = None,
    settings: Annotated[list[str] | None, typer.Option("--set")] = None,
) -> None:
    start, stop = (int(part) if part else None for part in frames.split(":"))
    sequence = open_sequence(recording).select(start, stop)
    config = load_config(settings=[f"mode={mode}", f"seed={seed}", *(settings or [])])
    print(f"{sequence.name}, {config.mode}, {len(sequence)} frames")
    print(f"{'':11} {'error m':>9} {'sigma m':>9} {'worst m':>9} {'during':>7} {'later':>7}  recovered after")
    for name in only or DISTURBANCES:
        disturbed = DISTURBANCES[name](sequence, round(at * len(sequence)), np.random.default_rng(seed))
        config = resolve_config(config, disturbed.sequence)
        row = judge(disturbed, list(estimate(disturbed.sequence, config)), config.scale.relative)
        during, later = (
            row.inside(part) for part in (slice(disturbed.first, disturbed.after), slice(disturbed.after, None))
        )
        last = np.flatnonzero(np.isfinite(row.error))[-1]
        print(
            f"{name:11} {row.error[last]:9.3f} {row.sigma[last]:9.3f} {np.nanmax(row.error):9.3f} "
            f"{100 * during:5.0f} % {100 * later:5.0f} %  {'-' if row.recovered is None else row.recovered}",
            flush=True,
        )


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
