"""A whole run of an estimator."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from fvslam_graph.core.frame_result import EarthPlacement, Ending, FrameResult
from fvslam_graph.core.sensors import SensorSeries
from fvslam_graph.core.trajectory import Trajectory


@dataclass(frozen=True)
class Relatives:
    """Estimated relative motions.

    Attributes:
        previous: (N,) index of the frame that the motion to frame i starts from.
        prev_T_cur: (N, 4, 4) homogeneous matrices.
        covariances: (N, 6, 6) in the tangent of prev_T_cur; NaN where there is none.
    """

    previous: NDArray[np.int64]
    prev_T_cur: NDArray[np.float64]
    covariances: NDArray[np.float64]

    def first(self, count: int) -> Relatives:
        """Those of the first frames."""
        return Relatives(self.previous[:count], self.prev_T_cur[:count], self.covariances[:count])


@dataclass(frozen=True)
class Run:
    """A whole run, in memory or as read back from its folder.

    Attributes:
        name: For tables and plots.
        online: One pose a frame, as known when the frame arrived.
        smoothed: The poses after all data, where the mode has them.
        ground_truth: world_T_camera, with stamps and world of its own.
        frames: Columns of frames.csv, (N,) each.
        config: The effective settings.
        info: What run.json holds; see `RunWriter`.
        relatives: None where they are not in the folder,
        pose_covariances: (N, 6, 6) of the online poses, in their tangents: likewise.
        gnss: Fixes of a receiver, where the recording has them.
        folder: Where it is written; None for a run in memory.
    """

    name: str
    online: Trajectory
    smoothed: Trajectory | None
    ground_truth: Trajectory | None
    frames: dict[str, NDArray[Any]]
    config: dict[str, Any]
    info: dict[str, Any]
    relatives: Relatives | None
    pose_covariances: NDArray[np.float64] | None = None
    gnss: SensorSeries | None = None
    folder: Path | None = None

    def __repr__(self) -> str:
        return f"Run({self.name!r}, {', '.join(self._facts.values())})"

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(fact)}</td></tr>" for name, fact in self._facts.items())
        return f"<table>{rows}</table>"

    @property
    def _facts(self) -> dict[str, str]:
        """What it is, in a few words."""
        return {
            "mode": f"{self.info.get('mode') or 'unknown mode'} on {self.info.get('sequence') or 'unnamed sequence'}",
            "status": str(self.info.get("status")),
            "poses": f"{len(self.online)} poses of {self.info.get('frames') or 'unknown'} frames",
            "path": f"{self.online.path_length:.4g} m, scale from {self.info.get('scale_source') or 'unknown'}",
            "ground truth": "no ground truth" if self.ground_truth is None else "with ground truth",
        }

    @property
    def coverage(self) -> float:
        """Poses out / frames in; NaN where the number of frames was not stored."""
        return len(self.online) / (self.info.get("frames") or np.nan)


def ending_info(ending: Ending | None) -> dict[str, Any]:
    """What run.json says of the end.

    How many poses are `smoothed`, the `calibration` with its deviations, and the `placement` on Earth.
    """
    if ending is None:
        return {}
    calibration = {"calibration": asdict(ending.calibration)} if ending.calibration else {}
    placement = {} if ending.placement is None else {"placement": _placement_info(ending.placement)}
    return {"smoothed": ending.summary} | calibration | placement


def _placement_info(placement: EarthPlacement) -> dict[str, Any]:
    """Plain numbers.

    The origin, enu_T_world (4, 4), its covariance (6, 6), rotation first, the clock's offset, and what the given height
    is to be multiplied by.
    """
    height = {} if placement.height is None else {"height": asdict(placement.height)}
    enu_T_world = placement.enu_T_world
    return {
        "origin": placement.origin.tolist(),
        "enu_T_world": enu_T_world.mean.matrix().tolist(),
        "covariance": enu_T_world.covariance.tolist(),
        "clock": asdict(placement.clock),
    } | height


def collect(
    results: Iterable[FrameResult],
    config: BaseModel,
    metadata: Mapping[str, Any],
    ground_truth: Trajectory | None = None,
    gnss: SensorSeries | None = None,
    finish: Callable[[], Ending | None] = lambda: None,
) -> Run:
    """A run in memory, from what an estimator says frame by frame; the arguments are those of `RunWriter`."""
    results = list(results)
    rows = [
        {"index": result.index, "stamp": result.stamp, "status": result.status.value, **result.measures}
        | {f"{stage}_ms": value for stage, value in result.times.items()}
        for result in results
    ]
    ending = finish()
    return Run(
        name="-".join(str(metadata[key]) for key in ("sequence", "mode")),
        online=Trajectory(np.array([result.stamp for result in results]), tuple(r.pose.mean for r in results)),
        smoothed=ending.smoothed if ending else None,
        ground_truth=ground_truth,
        frames={name: np.array([row[name] for row in rows]) for name in rows[0]},
        config=config.model_dump(mode="json"),
        info={"status": "finished", **metadata, **ending_info(ending)},
        relatives=Relatives(
            np.array([result.previous for result in results], dtype=np.int64),
            np.array([result.relative.mean.matrix() for result in results]),
            np.array([result.relative.covariance for result in results]),
        ),
        pose_covariances=np.array([result.pose.covariance for result in results]),
        gnss=gnss,
    )
