"""The loop over the frames of a sequence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import gtsam
import numpy as np

from fvslam_graph.config import Config, ScaleSource
from fvslam_graph.errors import ConfigError
from fvslam_graph.results import FrameResult
from fvslam_graph.sequences.base import Sequence
from fvslam_graph.stopwatch import Stopwatch
from fvslam_graph.vo.estimate import VoEstimate
from fvslam_graph.vo.odometry import VisualOdometry

STAGES = ("read", "association", "pose", "scale", "detection")


def estimate(sequence: Sequence, config: Config) -> Iterator[FrameResult]:
    """Run visual odometry over a sequence: one result a frame, in order, as soon as it is known.

    Raises:
        ConfigError: The scale source needs what the sequence does not have.
    """
    vo = VisualOdometry(sequence.camera, config, sequence.ground, _true_baseline(sequence, config))
    poses: list[gtsam.Pose3] = []
    for index in range(len(sequence)):
        stopwatch = Stopwatch()
        with stopwatch.stage("read"):
            frame = sequence.frame(index)
        odometry = vo.step(frame)
        start = poses[odometry.previous] if odometry.previous < index else gtsam.Pose3()  # the first usable image
        poses.append(start.compose(odometry.prev_T_cur))
        times = dict.fromkeys(STAGES, 0.0) | stopwatch.times | odometry.times
        yield FrameResult(
            index=index,
            stamp=frame.stamp,
            pose=poses[-1],
            status=odometry.status,
            previous=odometry.previous,
            relative=odometry.prev_T_cur,
            covariance=odometry.covariance,
            measures=_measures(odometry),
            times=times,
        )


def applicable(config: Config, sequence: Sequence) -> Config:
    """The settings that hold for a sequence: without a known ground, the scale is relative.

    Raises:
        ConfigError: The scale source is `oracle` and there is no ground truth.
    """
    source = config.scale.source
    if source is ScaleSource.ORACLE and sequence.ground_truth is None:
        raise ConfigError(f"{sequence.name} has no ground truth for the scale source 'oracle'; choose another source")
    no_ground = sequence.ground is None or not np.any(sequence.ground.heights > 0)
    if source is ScaleSource.PLANE and no_ground:
        scale = config.scale.model_copy(update={"source": ScaleSource.MAP})
        return config.model_copy(update={"scale": scale})
    return config


def facts(sequence: Sequence, config: Config) -> dict[str, Any]:
    """What a run folder says about its sequence and mode."""
    return {
        "mode": "vo",
        "sequence": sequence.name,
        "format": sequence.format,
        "frames": len(sequence),
        "scale_source": config.scale.source.value,
        "ground": None if sequence.ground is None else sequence.ground.source,
        "down": None if sequence.ground is None else sequence.ground.normal,
        "notes": list(sequence.notes),
        "seed": config.seed,
    }


def _true_baseline(sequence: Sequence, config: Config) -> Callable[[int, int], float] | None:
    """Distance between two frames by the ground truth, for the scale source `oracle` and for it alone."""
    if config.scale.source is not ScaleSource.ORACLE or sequence.ground_truth is None:
        return None
    truth = sequence.ground_truth.interpolate(sequence.stamps)
    position = dict(zip(truth.stamps, truth.positions, strict=True))

    def distance(a: int, b: int) -> float:
        start, end = position.get(sequence.stamps[a]), position.get(sequence.stamps[b])
        return math.nan if start is None or end is None else float(np.linalg.norm(end - start))

    return distance


def _measures(odometry: VoEstimate) -> dict[str, float]:
    scale = odometry.scale
    return {
        "tracks": odometry.found,
        "inliers": len(odometry.tracks),
        "scale": math.nan if scale is None else scale.metres,
        "scale_sigma": math.nan if scale is None else scale.metres * math.sqrt(scale.variance),
        "parallax_px": odometry.parallax,
    }
