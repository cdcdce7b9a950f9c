"""A sequence through an estimator, into memory or the folder of a run."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from fvslam_graph.core.config import Config, ScaleSource
from fvslam_graph.core.errors import ConfigError
from fvslam_graph.core.frame_result import FrameResult
from fvslam_graph.core.sensors import SensorKind
from fvslam_graph.core.sequence import Frame, Sequence
from fvslam_graph.estimator import frame_estimator
from fvslam_graph.runs.results import Run, collect
from fvslam_graph.runs.run_folder import RunWriter, read_run

Watch = Callable[[Iterable[FrameResult]], Iterable[FrameResult]]
"""Takes results as they come; hands them on."""


def run_sequence(
    sequence: Sequence, config: Config, out: Path | None = None, watch: Watch = lambda results: results
) -> Run:
    """Run the configured mode over a sequence.

    Args:
        sequence: Its frames are read one by one.
        config: Mode, settings and seed; see `resolve_config`.
        out: Folder of the run; without it, nothing is written.
        watch: To show the progress.

    Raises:
        ConfigError: The scale source needs what the sequence does not have.
        ResultsError: The folder holds something else than a run, is in use, or cannot be written.
    """
    config = resolve_config(config, sequence)
    metadata = run_metadata(sequence, config)
    gnss = next((series for series in sequence.sensors if series.kind is SensorKind.GNSS), None)
    estimator = frame_estimator(sequence, config)
    results, finish = watch(estimator.through(sequence)), estimator.finish
    if out is None:
        return collect(results, config, metadata, sequence.ground_truth, gnss, finish)
    with RunWriter(out, config, metadata, sequence.ground_truth, gnss, finish) as writer:
        for result in results:
            writer.add(result)
    return read_run(out)


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


def resolve_config(config: Config, sequence: Sequence) -> Config:
    """The settings that hold for a sequence: without a known ground, the scale is relative.

    Raises:
        ConfigError: The scale source is `oracle` and there is no ground truth.
    """
    source = config.scale.source
    if source is ScaleSource.ORACLE and sequence.ground_truth is None:
        raise ConfigError(f"{sequence.name} has no ground truth for the scale source 'oracle'; choose another source")
    no_ground = sequence.ground is None or not np.any(sequence.ground.heights > 0)
    if source is ScaleSource.PLANE and no_ground:
        return config.in_relative_scale()
    return config


def run_metadata(sequence: Sequence, config: Config) -> dict[str, Any]:
    """The entries of run.json about sequence and mode."""
    camera = sequence.camera
    return {
        "mode": config.mode.value,
        "sequence": sequence.name,
        "format": sequence.format,
        "frames": len(sequence),
        "source": sequence.source,
        "camera": {"width": camera.width, "height": camera.height}
        | {name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")},
        "scale_source": config.scale.source.value,
        "ground": None if sequence.ground is None else sequence.ground.source,
        "down": None if sequence.ground is None else sequence.ground.normal,
        "notes": list(sequence.notes),
        "seed": config.seed,
    }
