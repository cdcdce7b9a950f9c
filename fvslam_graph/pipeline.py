"""A sequence through an estimator, into memory or the folder of a run."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from fvslam_graph.core.choices import Mode, ScaleSource
from fvslam_graph.core.config import Config
from fvslam_graph.core.errors import ConfigError
from fvslam_graph.core.frame_result import Ending, FrameResult
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.modes import outside_mode
from fvslam_graph.core.outside import method_results
from fvslam_graph.core.plugins import Kind, Plugin, find
from fvslam_graph.core.sensors import SensorKind
from fvslam_graph.core.sequence import Frame, Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.estimator import frame_estimator, through
from fvslam_graph.runs.results import Run, collect
from fvslam_graph.runs.run_folder import RunWriter, read_run

OWN_SCALE = "own"
"""The scale source of estimators of other packages."""
Watch = Callable[[Iterable[FrameResult]], Iterable[FrameResult]]
"""Takes results as they come; hands them on."""

ENU_COLUMNS = ("east", "north", "up", "east_sigma", "north_sigma", "up_sigma")


def run_sequence(
    sequence: Sequence,
    config: Config,
    out: Path | None = None,
    watch: Watch = lambda results: results,
    method: Plugin | None = None,
) -> Run:
    """Run the configured mode over a sequence.

    Args:
        sequence: Its frames are read one by one.
        config: Mode, settings and seed; see `resolve_config`.
        out: Folder of the run; without it, nothing is written.
        watch: To show the progress.
        method: A function of a sequence and a seed, which runs in place of the mode; this is its name then.

    Raises:
        ConfigError: The scale source needs what the sequence does not have.
        ResultsError: The folder holds something else than a run, is in use, or cannot be written.
    """
    config = resolve_config(config, sequence)
    metadata = run_metadata(sequence, config, method)
    gnss = sequence.gnss or next((series for series in sequence.sensors if series.kind is SensorKind.GNSS), None)
    results, finish = _begin(sequence, config, method or outside_mode(config.mode))
    if sequence.start is not None:
        results, finish = _in_world(sequence.start, results, finish)
    results = watch(results)
    if sequence.gnss is not None:
        results = map(_with_enu_columns, results)
    if out is None:
        return collect(results, config, metadata, sequence.ground_truth, gnss, finish)
    with RunWriter(out, config, metadata, sequence.ground_truth, gnss, finish) as writer:
        for result in results:
            writer.add(result)
    return read_run(out)


def _in_world(
    start: gtsam.Pose3, results: Iterable[FrameResult], finish: Callable[[], Ending | None]
) -> tuple[Iterable[FrameResult], Callable[[], Ending | None]]:
    """The same in a world in which the first camera is at `start`; the graph's own files stay in that of the camera."""
    begin = GaussianPose(start, np.zeros((6, 6)))

    def placed() -> Ending | None:
        ending = finish()
        if ending is not None and ending.smoothed is not None:
            smoothed = Trajectory(ending.smoothed.stamps, tuple(map(start.compose, ending.smoothed.poses)))
            ending = replace(ending, smoothed=smoothed)
        if ending is not None and ending.placement is not None:
            enu_T_world = ending.placement.enu_T_world.compose(begin.inverse())
            ending = replace(ending, placement=replace(ending.placement, enu_T_world=enu_T_world))
        return ending

    return (replace(result, pose=begin.compose(result.pose)) for result in results), placed


def run_live(
    frames: Iterable[Frame],
    sequence: Sequence,
    config: Config,
    out: Path | None = None,
    watch: Watch = lambda results: results,
) -> Run | None:
    """Run the configured mode over frames that come one by one, until there are no more.

    Args:
        frames: In the order of their stamps, numbered from 0.
        sequence: What is known of them beforehand: camera and ground. Its own frames are not read.
        config: As for `run_sequence`.
        out: Folder of the run; without it, nothing is written.
        watch: Takes what is estimated, frame by frame.

    Returns:
        What is in the folder; None without one.

    Raises:
        ConfigError: The scale source needs what a live camera does not have.
        ResultsError: As by `run_sequence`.
    """
    config = resolve_config(config, sequence)
    estimator = frame_estimator(sequence, config)
    results = watch(map(estimator.step, frames))
    if out is None:
        deque(results, maxlen=0)
        return None
    metadata = run_metadata(sequence, config) | {"frames": None}
    with RunWriter(out, config, metadata, finish=estimator.finish) as writer:
        for result in results:
            writer.add(result)
    return read_run(out)


def _begin(
    sequence: Sequence, config: Config, outside: Plugin | None
) -> tuple[Iterable[FrameResult], Callable[[], Ending | None]]:
    """The results as they come, and what to call after the last of them."""
    if outside is not None and outside.is_method:
        return method_results(config.mode, outside.object, sequence, config.seed), lambda: None
    estimator = frame_estimator(sequence, config)
    return through(estimator, sequence), estimator.finish


def resolve_config(config: Config, sequence: Sequence) -> Config:
    """The settings that hold for a sequence: without a known ground, the scale is relative.

    Raises:
        ConfigError: The scale source is `oracle` and there is no ground truth; or fixes of a receiver are to be used
            without a factor graph or without metres.
    """
    config = _with_known_scale(config, sequence)
    if sequence.gnss is not None and config.mode != Mode.GRAPH:
        raise ConfigError(f"fixes of a GNSS receiver are used in mode graph alone, not in {config.mode}")
    if sequence.gnss is not None and config.scale.relative:
        raise ConfigError(
            f"fixes of a GNSS receiver are used in runs in metres, and nothing tells those of {sequence.name}; "
            "give --camera-height or --altimeter, or place the finished run by `fvslam export --gnss`"
        )
    return config


def _with_known_scale(config: Config, sequence: Sequence) -> Config:
    if _has_own_scale(outside_mode(config.mode)):
        return config
    source = config.scale.source
    if source is ScaleSource.ORACLE and sequence.ground_truth is None:
        raise ConfigError(f"{sequence.name} has no ground truth for the scale source 'oracle'; choose another source")
    no_ground = sequence.ground is None or not np.any(sequence.ground.heights > 0)
    if source is ScaleSource.PLANE and no_ground:
        return config.in_relative_scale()
    return config


def run_metadata(sequence: Sequence, config: Config, method: Plugin | None = None) -> dict[str, Any]:
    """The entries of run.json about sequence and mode; arguments as for `run_sequence`."""
    others = (method, find(sequence.format, (Kind.FORMAT,), ()))
    camera, start = sequence.camera, sequence.start or gtsam.Pose3()
    return {
        "mode": config.mode,
        "sequence": sequence.name,
        "format": sequence.format,
        "frames": len(sequence),
        "source": sequence.source,
        "camera": {"width": camera.width, "height": camera.height}
        | {name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")},
        "scale_source": OWN_SCALE if _has_own_scale(method or outside_mode(config.mode)) else config.scale.source.value,
        "ground": None if sequence.ground is None else sequence.ground.source,
        "down": None if sequence.ground is None else start.rotation().rotate(sequence.ground.normal),
        "start": None if sequence.start is None else start.matrix(),
        "gnss": None if sequence.gnss is None else sequence.gnss.source,
        "notes": list(sequence.notes),
        "seed": config.seed,
        "plugins": [*config.origins, *(other.origin for other in others if other is not None)],
    }


def _with_enu_columns(result: FrameResult) -> FrameResult:
    """The result with the camera's place on Earth among its measures, NaN before it is known."""
    numbers = np.full(6, np.nan)
    if result.enu is not None:
        rotation = result.enu.mean.rotation().matrix()
        variances = np.diag(rotation @ result.enu.covariance[3:, 3:] @ rotation.T)
        numbers = np.concatenate([result.enu.mean.translation(), np.sqrt(variances)])
    return replace(result, measures=dict(result.measures) | dict(zip(ENU_COLUMNS, numbers.tolist(), strict=True)))


def _has_own_scale(outside: Plugin | None) -> bool:
    """Whether the scale source of the settings does not hold: for estimators of other packages."""
    return outside is not None and outside.kind is Kind.ESTIMATOR
