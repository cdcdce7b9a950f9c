"""What GNSS and an altimeter bring: errors on Earth, consistency and scale, over seeds of the sensors' noise.

`gnss PATH...` adds a simulated receiver to recordings with ground truth. Errors are RMSE of all three axes, in metres;
`rigid` is that of the true path laid upon the right fixes, of an estimator without drift: by the right clock, or by the
one that fits best. `altimeter` flies over generated terrain with noisy heights. NEES of positions has an expectation
of 3.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import gtsam
import numpy as np
import typer
from numpy.typing import NDArray
from one_sentence import one_sentence

from fvslam_graph.core.config import Config, load_config
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.geodesy import LocalFrame
from fvslam_graph.core.sensors import SensorSeries
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.estimator import frame_estimator, through
from fvslam_graph.sequences.altimeter import read_altimeter, with_altimeter
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.simulation.gnss import OUTLIER, PLACE, SimulatedReceiver, true_enu

Array = NDArray[np.float64]

HEIGHT_SIGMA, HEIGHT_OUTLIERS, HEIGHT_OFF, HEIGHT_RATE = 0.2, 0.05, 5.0, 7.0  # m, share, m, Hz
OFFSETS = np.arange(-1, 1.005, 0.01)  # seconds of the clock

app = typer.Typer()


@app.command()
def gnss(
    paths: list[str],
    receiver: Annotated[str, typer.Option(help="HZ:SIGMA[:OUTLIERS[:GAP_S]]")] = "1:1.5:0.2:10",
    seeds: int = 5,
    clock: Annotated[float, typer.Option(help="Seconds that its stamps lack to be those of the images.")] = 0.0,
    settings: Annotated[str, typer.Option()] = "",
) -> None:
    """Errors on Earth of recordings with a simulated receiver."""
    print(
        "recording, seed: smoothed, online, GNSS alone, rigid, rigid at a clock of its own; mean NEES online; "
        "first placed frame; clock and its deviation"
    )
    config = load_config(settings=["mode=graph", *settings.split()])
    for path in paths:
        sequence = replace(open_sequence(path), sensors=())
        rows = []
        for seed in range(seeds):
            fixes = SimulatedReceiver.parse(receiver).fixes(sequence, seed)
            late = sequence.with_gnss(replace(fixes, stamps=fixes.stamps - clock))
            rows.append(_gnss_row(late, fixes, config))
            print(f"{sequence.name}, {seed}: " + ", ".join(f"{number:.2f}" for number in rows[-1]), flush=True)
        rms = np.sqrt(np.mean(np.square(rows), axis=0))
        print(f"{sequence.name}, RMS: " + ", ".join(f"{number:.2f}" for number in rms[:5]))
        print(f"{sequence.name}, mean NEES {np.mean(rows, axis=0)[5]:.2f}", flush=True)


@app.command()
def altimeter(
    seeds: int = 10, world: str = "synthetic:uav?frames=80&size=320x240", settings: Annotated[str, typer.Option()] = ""
) -> None:
    """Scale and NEES of flights whose height is measured by an altimeter with noise and outliers."""
    scales, values = [], []
    for seed in range(seeds):
        exact = open_sequence(f"{world}&seed={seed}")
        sequence = with_altimeter(exact, _altimeter(exact, seed))
        truth = exact.ground_truth
        assert truth is not None
        config = load_config(settings=["mode=graph", *settings.split()])
        results = list(through(frame_estimator(sequence, config), sequence))
        estimated = np.array([result.pose.mean.translation() for result in results])
        pairs = list(zip(truth.positions, estimated, strict=True))
        scales.append(1 / gtsam.Similarity3.Align(pairs).scale())
        values.append(np.mean([_nees(r.pose, p.translation()) for r, p in zip(results, truth.poses, strict=True)][10:]))
        print(f"seed {seed}: scale {scales[-1]:.4f}, mean NEES {values[-1]:.2f}", flush=True)
    errors = np.array(scales) - 1
    print(f"scale error: mean {errors.mean():.4f}, RMS {np.sqrt((errors**2).mean()):.4f}; NEES {np.mean(values):.2f}")


def _gnss_row(sequence: Sequence, fixes: SensorSeries, config: Config) -> list[float]:
    """What a run says, against the truth and the fixes at their right times."""
    truth = sequence.ground_truth
    assert truth is not None
    estimator = frame_estimator(sequence, config)
    results = list(through(estimator, sequence))
    ending = estimator.finish()
    assert ending is not None and ending.smoothed is not None
    if ending.placement is None:
        raise FvslamError(
            f"{sequence.name}: too few fixes are right to tell where it lies on Earth; try --receiver 5:1.5"
        )
    earth, place = LocalFrame(PLACE), LocalFrame(ending.placement.origin)
    known = truth.interpolate(sequence.stamps)
    path = place.enu(earth.geodetic(true_enu(known)))
    true = dict(zip(known.stamps.tolist(), path, strict=True))
    online = [(r.enu, true[r.stamp]) for r in results if r.enu is not None and r.stamp in true]
    smoothed = ending.placement.enu_T_world.mean.transformFrom(ending.smoothed.positions.T).T
    pairs = zip(ending.smoothed.stamps.tolist(), smoothed, strict=True)
    measured = place.enu(fixes.values)
    alone = _along(measured, fixes.stamps, known.stamps)
    rigid = [_rigid(known.stamps, path, fixes.stamps, measured, offsets) for offsets in (np.zeros(1), OFFSETS)]
    return [
        _rmse([position - true[stamp] for stamp, position in pairs if stamp in true]),
        _rmse([pose.mean.translation() - position for pose, position in online]),
        _rmse(alone - path),
        *(_rmse(laid - path) for laid in rigid),
        float(np.mean([_nees(pose, position) for pose, position in online])),
        float(next(result.index for result in results if result.enu is not None)),
        ending.placement.clock.offset,
        ending.placement.clock.sigma,
    ]


def _rigid(stamps: Array, path: Array, fix_stamps: Array, fixes: Array, offsets: Array) -> Array:
    """The true path, moved and turned as a whole to fit the fixes that are not wrong, and their clock's offset."""
    off = np.linalg.norm(fixes - _along(path, stamps, fix_stamps), axis=1)
    fix_stamps, fixes = fix_stamps[off < OUTLIER / 2], fixes[off < OUTLIER / 2]
    best, least = path, np.inf
    for offset in offsets:
        there = _along(path, stamps, fix_stamps + offset)
        a, b = there.mean(axis=0), fixes.mean(axis=0)
        rotation = gtsam.Rot3.ClosestTo((fixes - b).T @ (there - a)).matrix()
        cost = ((fixes - b - (there - a) @ rotation.T) ** 2).sum()
        if cost < least:
            best, least = (path - a) @ rotation.T + b, cost
    return best


def _along(positions: Array, stamps: Array, at: Array) -> Array:
    return np.column_stack([np.interp(at, stamps, column) for column in positions.T])


def _nees(pose: GaussianPose, position: Array) -> float:
    rotation = pose.mean.rotation().matrix()
    error = pose.mean.translation() - position
    return float(error @ np.linalg.solve(rotation @ pose.covariance[3:, 3:] @ rotation.T + 1e-12 * np.eye(3), error))


def _rmse(errors: list[Array] | Array) -> float:
    return float(np.sqrt((np.array(errors) ** 2).sum(axis=1).mean()))


def _altimeter(sequence: Sequence, seed: int) -> SensorSeries:
    """Readings of the true height with noise and outliers, at a rate of their own."""
    assert sequence.ground is not None
    rng = np.random.default_rng([seed, 6])
    stamps = np.arange(sequence.stamps[0] - 1, sequence.stamps[-1] + 1, 1 / HEIGHT_RATE)
    heights = np.interp(stamps, sequence.stamps, sequence.ground.heights) + HEIGHT_SIGMA * rng.standard_normal(
        len(stamps)
    )
    wrong = rng.random(len(stamps)) < HEIGHT_OUTLIERS
    heights[wrong] += HEIGHT_OFF * rng.choice([-1, 1], wrong.sum())
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "altimeter.csv"
        file.write_text("stamp,height\n" + "".join(f"{s:.6f},{h:.4f}\n" for s, h in zip(stamps, heights, strict=True)))
        return read_altimeter(file)


if __name__ == "__main__":
    with one_sentence():
        app()
