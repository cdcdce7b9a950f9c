"""The folder of one run: what was estimated, frame by frame, and under which circumstances.

A run is written while it goes on, so that a run that is interrupted or killed keeps every frame up to there.
"""

from __future__ import annotations

import csv
import json
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO, TypeVar
from zipfile import BadZipFile

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel

from fvslam_graph.errors import ResultsError
from fvslam_graph.files import replacing, write_json, writing
from fvslam_graph.fusion.graph import Graph
from fvslam_graph.fusion.graph_files import FACTORS, G2O, LANDMARKS_PLY, VALUES
from fvslam_graph.landmark_table import COLUMNS, landmark_rows
from fvslam_graph.provenance import peak_memory_mb, provenance
from fvslam_graph.results import FrameResult, Relatives, Run
from fvslam_graph.slam.estimate import SlamEstimate
from fvslam_graph.trajectory import Trajectory, kitti_line, tum_line

ONLINE, ONLINE_KITTI = "trajectory_online.tum", "trajectory_online.kitti"
SMOOTHED, SMOOTHED_KITTI = "trajectory_smoothed.tum", "trajectory_smoothed.kitti"
GROUND_TRUTH, FRAMES, COVARIANCES = "ground_truth.tum", "frames.csv", "covariances.npz"
CONFIG, INFO, METRICS, REFERENCE = "config.yaml", "run.json", "metrics.json", "reference.tum"
LANDMARKS = "landmarks.csv"
GRAPH = (G2O, LANDMARKS_PLY, FACTORS, VALUES)

# Everything that a run, its evaluation and its plots leave in the folder; a new run into the same folder removes it.
_OURS = (
    *(ONLINE, ONLINE_KITTI, SMOOTHED, SMOOTHED_KITTI, GROUND_TRUTH, FRAMES, COVARIANCES, CONFIG, INFO),
    *GRAPH,
    *(LANDMARKS, METRICS, REFERENCE, "[ar]pe_*.zip", "row_*.json", "plot_*.png", "plot_*.pdf"),
)

_T = TypeVar("_T")


class RunWriter:
    """Writes a run folder; a context manager around the loop over the frames.

    A line per frame goes to `trajectory_online.tum` and `frames.csv`, one per landmark to `landmarks.csv`. `run.json`
    says "running" until the end, then "finished", "interrupted" or "failed: ...". The end also brings
    `trajectory_online.kitti` and `covariances.npz`, and in mode `graph` the smoothed trajectory and the graph.

    Args:
        folder: Created; may hold a previous run, which is replaced.
        config: The effective settings.
        facts: Go into run.json. Known to evaluation and plots: `sequence` (name), `frames` (how many the sequence has),
            `mode`, `scale_source`, `down` (3,), the direction of gravity in the first camera frame (None: unknown), and
            `source`, what `open_sequence` takes to open the recording again.
        ground_truth: Kept with the run, so that it can be evaluated without the recording.

    Raises:
        ResultsError: The folder holds something else than a run, or cannot be written.
    """

    def __init__(
        self, folder: Path, config: BaseModel, facts: Mapping[str, Any], ground_truth: Trajectory | None = None
    ) -> None:
        self.folder = folder
        self._facts = dict(facts)
        self._results: list[FrameResult] = []
        self._begin = time.perf_counter()
        with writing(folder):
            _claim(folder)
            self._write_info("running")
            settings = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
            (folder / CONFIG).write_text(settings)
            if ground_truth is not None:
                ground_truth.write_tum(folder / GROUND_TRUTH)
            self._trajectory = (folder / ONLINE).open("w")
            self._frames = (folder / FRAMES).open("w", newline="")
        self._landmarks: TextIO | None = None
        self._graph: Graph | None = None

    def __enter__(self) -> RunWriter:
        return self

    def add(self, result: FrameResult) -> None:
        """Write one frame; it is in the files when this returns."""
        row = {"index": result.index, "stamp": f"{result.stamp:.9f}", "status": result.status.value}
        row |= {name: f"{value:.9g}" for name, value in result.measures.items()}
        row |= {f"{stage}_ms": f"{value:.3f}" for stage, value in result.times.items()}
        with writing(self.folder):
            self._trajectory.write(tum_line(result.stamp, result.pose.mean))
            self._trajectory.flush()
            if not self._results:
                self._table = csv.DictWriter(self._frames, fieldnames=list(row), lineterminator="\n")
                self._table.writeheader()
            self._table.writerow(row)
            self._frames.flush()
            if result.slam is not None:
                self._write_landmarks(result.slam)
        self._graph = result.graph
        self._results.append(replace(result, slam=None, graph=None))  # on disk, and large

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is None:
            status = "finished"
        elif issubclass(kind, KeyboardInterrupt):
            status = "interrupted"
        else:
            status = f"failed: {str(error) or kind.__name__}"
        with writing(self.folder):
            self._trajectory.close()
            self._frames.close()
            if self._landmarks is not None:
                self._landmarks.close()
            with replacing(self.folder / ONLINE_KITTI) as path:
                path.write_text("".join(kitti_line(result.pose.mean) for result in self._results))
            with replacing(self.folder / COVARIANCES) as path:
                np.savez_compressed(
                    path,
                    previous=np.array([result.previous for result in self._results], dtype=np.int64),
                    prev_T_cur=np.array([r.relative.mean.matrix() for r in self._results]).reshape(-1, 4, 4),
                    covariances=np.array([r.relative.covariance for r in self._results]).reshape(-1, 6, 6),
                    pose_covariances=np.array([r.pose.covariance for r in self._results]).reshape(-1, 6, 6),
                )
            self._write_info(status)
            if self._graph is not None:
                self._write_graph(self._graph)

    def _write_graph(self, graph: Graph) -> None:
        smoothed = graph.smoothed()
        with replacing(self.folder / SMOOTHED) as path:
            smoothed.write_tum(path)
        with replacing(self.folder / SMOOTHED_KITTI) as path:
            path.write_text("".join(kitti_line(pose) for pose in smoothed.poses))
        graph.write(self.folder)

    def _write_landmarks(self, slam: SlamEstimate) -> None:
        if self._landmarks is None:
            self._landmarks = (self.folder / LANDMARKS).open("w")
            self._landmarks.write(",".join(COLUMNS) + "\n")
        self._landmarks.write(landmark_rows(slam))
        self._landmarks.flush()

    def _write_info(self, status: str) -> None:
        info = {"status": status, **self._facts, **provenance(), "totals": self._totals()}
        write_json(self.folder / INFO, info)

    def _totals(self) -> dict[str, Any]:
        stages = list(self._results[0].times) if self._results else []
        times = {stage: np.array([result.times[stage] for result in self._results]) for stage in stages}
        if times:
            times["total"] = np.sum(list(times.values()), axis=0)
        return {
            "frames": len(self._results),
            "statuses": Counter(result.status.value for result in self._results),
            "seconds": time.perf_counter() - self._begin,
            "ms_per_frame": {
                stage: {"median": float(np.median(ms)), "mean": float(np.mean(ms))} for stage, ms in times.items()
            },
            "peak_memory_mb": peak_memory_mb(),
        }


def read_run(folder: Path) -> Run:
    """Read a run folder, also of a run that goes on or was killed: its last, incomplete line is left out.

    Raises:
        ResultsError: The folder is not that of a run, or one of its files is damaged.
        TrajectoryError: One of its trajectories is damaged.
    """
    if not (folder / INFO).is_file():
        raise ResultsError(f"{folder} is not the folder of a run: it has no {INFO}; give the output folder of a run")
    frames = _parsed(folder / FRAMES, _read_frames)
    stamps = frames.get("stamp", np.empty(0))
    written = Trajectory.read_tum(folder / ONLINE, unfinished=True) if len(stamps) else Trajectory(stamps, ())
    relatives = _parsed(folder / COVARIANCES, _read_relatives) if (folder / COVARIANCES).exists() else None
    # Where the run was stopped between two writes, one file is a frame ahead of another.
    count = min(len(written), len(stamps), len(stamps if relatives is None else relatives.previous))
    return Run(
        name=folder.resolve().name,
        online=Trajectory(written.stamps[:count], written.poses[:count]),
        smoothed=_read_optional(folder / SMOOTHED),
        ground_truth=_read_optional(folder / GROUND_TRUTH),
        frames={name: column[:count] for name, column in frames.items()},
        config=_parsed(folder / CONFIG, lambda path: yaml.safe_load(path.read_text())),
        info=_parsed(folder / INFO, lambda path: json.loads(path.read_text())),
        relatives=relatives,
        folder=folder,
    )


def _claim(folder: Path) -> None:
    """Make the folder empty and ours, or refuse."""
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()) and not (folder / INFO).is_file():
        raise ResultsError(
            f"{folder} holds files that are not of a run; give another or an empty folder for the output"
        )
    for pattern in _OURS:
        for path in folder.glob(pattern):
            path.unlink()


def _parsed(path: Path, parse: Callable[[Path], _T]) -> _T:
    try:
        return parse(path)
    # What the readers of csv, yaml, json and npz raise at damaged files has no common base.
    except (OSError, ValueError, KeyError, EOFError, yaml.YAMLError, BadZipFile) as error:
        reason = " ".join(str(error).split())
        raise ResultsError(f"{path} cannot be read, the run must be done again: {reason}") from None


def _read_frames(path: Path) -> dict[str, NDArray[Any]]:
    text = path.read_text()
    reader = csv.DictReader(text[: text.rfind("\n") + 1].splitlines(), restval="missing")
    rows = list(reader)
    types = {"index": np.int64, "status": np.str_}
    names = reader.fieldnames or ()
    return {name: np.array([row[name] for row in rows]).astype(types.get(name, np.float64)) for name in names}


def _read_relatives(path: Path) -> Relatives:
    with np.load(path) as arrays:
        return Relatives(arrays["previous"], arrays["prev_T_cur"], arrays["covariances"])


def _read_optional(path: Path) -> Trajectory | None:
    return Trajectory.read_tum(path) if path.exists() else None
