"""The files of a run that grow by every frame: neither how long a run is nor how it ends is known beforehand."""

from __future__ import annotations

import csv
import io
from array import array
from collections import Counter, defaultdict
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TextIO

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.files import write_file, writing
from fvslam_graph.core.frame_result import FrameResult
from fvslam_graph.core.slam_estimate import SlamEstimate
from fvslam_graph.core.trajectory import kitti_line, tum_line
from fvslam_graph.runs.landmark_table import LANDMARK_COLUMNS, landmark_rows

ONLINE, ONLINE_KITTI = "trajectory_online.tum", "trajectory_online.kitti"
FRAMES, LANDMARKS, COVARIANCES = "frames.csv", "landmarks.csv", "covariances.npz"
POSES = "poses.bin"  # until the end, when its content goes to the other two files of poses

_POSE = np.dtype(
    [
        ("previous", np.int64),
        ("prev_T_cur", np.float64, (4, 4)),
        ("covariances", np.float64, (6, 6)),
        ("world_T_camera", np.float64, (4, 4)),
        ("pose_covariances", np.float64, (6, 6)),
    ]
)


class FrameFiles:
    """Appends frames to the files of a run. What is kept in memory of a frame is how long its stages took.

    Args:
        folder: Of the run.
        stack: Closes the files.
    """

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._folder, self._stack = folder, stack
        self._trajectory = stack.enter_context((folder / ONLINE).open("w"))
        self._frames = stack.enter_context((folder / FRAMES).open("w", newline=""))
        self._poses = stack.enter_context((folder / POSES).open("wb"))
        self._landmarks: TextIO | None = None
        self._statuses: Counter[str] = Counter()
        self._times: dict[str, array[float]] = defaultdict(lambda: array("d"))  # milliseconds, by stage

    def add(self, result: FrameResult) -> None:
        """Write one frame; it is in the files when this returns."""
        row = {"index": result.index, "stamp": f"{result.stamp:.9f}", "status": result.status.value}
        row |= {name: f"{value:.9g}" for name, value in result.measures.items()}
        row |= {f"{stage}_ms": f"{value:.3f}" for stage, value in result.times.items()}
        motion, pose = result.relative, result.pose
        pose_row = np.array(
            (result.previous, motion.mean.matrix(), motion.covariance, pose.mean.matrix(), pose.covariance), _POSE
        )
        with writing(self._folder):
            self._trajectory.write(tum_line(result.stamp, pose.mean))
            self._trajectory.flush()
            if not self._statuses:
                self._table = csv.DictWriter(self._frames, fieldnames=list(row), lineterminator="\n")
                self._table.writeheader()
            self._table.writerow(row)
            self._frames.flush()
            self._poses.write(pose_row.tobytes())
            self._poses.flush()
            if result.slam is not None:
                self._add_landmarks(result.slam)
        self._statuses[result.status.value] += 1
        for stage, value in result.times.items():
            self._times[stage].append(value)

    def close(self) -> None:
        """Write what is to be written; no frame is added any more."""
        for file in (self._trajectory, self._frames, self._poses, self._landmarks):
            if file is not None:
                file.close()

    def totals(self) -> dict[str, Any]:
        """How many frames there are, how they ended, and how long they took."""
        times = {stage: np.array(ms) for stage, ms in self._times.items()}
        if times:
            times["total"] = np.sum(list(times.values()), axis=0)
        return {
            "frames": self._statuses.total(),
            "statuses": self._statuses,
            "ms_per_frame": {
                stage: {"median": float(np.median(ms)), "mean": float(np.mean(ms))} for stage, ms in times.items()
            },
        }

    def _add_landmarks(self, slam: SlamEstimate) -> None:
        if self._landmarks is None:
            self._landmarks = self._stack.enter_context((self._folder / LANDMARKS).open("w"))
            self._landmarks.write(",".join(LANDMARK_COLUMNS) + "\n")
        self._landmarks.write(landmark_rows(slam))
        self._landmarks.flush()


def write_arrays(folder: Path) -> None:
    """Write the poses of a run in the formats in which they are read, once its files are closed."""
    poses = np.fromfile(folder / POSES, _POSE)
    lines = (kitti_line(gtsam.Pose3(matrix)) for matrix in poses["world_T_camera"])
    write_file(folder / ONLINE_KITTI, "".join(lines))
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, **_arrays(poses))
    write_file(folder / COVARIANCES, content.getvalue())
    (folder / POSES).unlink()


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of `covariances.npz`, or of the file that is there until the end: of whole rows."""
    if not path.is_file():  # a pipe would wait for ever
        raise ValueError("it is no file")
    if path.name == POSES:
        return _arrays(np.fromfile(path, _POSE))
    with np.load(path) as arrays:
        return dict(arrays)


def _arrays(poses: NDArray[np.void]) -> dict[str, NDArray[Any]]:
    return {name: poses[name] for name in ("previous", "prev_T_cur", "covariances", "pose_covariances")}
