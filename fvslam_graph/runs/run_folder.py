"""The folder of one run: what was estimated, frame by frame, and under which circumstances.

A run is written while it goes on, so that a run that is interrupted or killed keeps every frame up to there.
"""

from __future__ import annotations

import csv
import json
import logging
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, FiniteFloat, NonNegativeInt, ValidationError

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.errors import CameraError, ResultsError
from fvslam_graph.core.files import replacing, write_file, write_json, writing
from fvslam_graph.core.frame_result import FACTORS, G2O, LANDMARKS_PLY, VALUES, Ending, FrameResult
from fvslam_graph.core.sensors import SensorSeries
from fvslam_graph.core.text_files import OWN_MAX_SIZE, read_text
from fvslam_graph.core.trajectory import Status, Trajectory, kitti_line
from fvslam_graph.core.validation import complaint
from fvslam_graph.core.yaml_files import read_yaml_mapping
from fvslam_graph.runs.frame_files import (
    COVARIANCES,
    FRAMES,
    LANDMARKS,
    ONLINE,
    ONLINE_KITTI,
    POSES,
    FrameFiles,
    read_arrays,
    write_arrays,
)
from fvslam_graph.runs.gnss_file import read_fixes, write_fixes
from fvslam_graph.runs.ownership import INFO, LOCK, MARK, FolderKind, claimed, disown, kind_of
from fvslam_graph.runs.provenance import forget_peak_memory, peak_memory_mb, provenance, seconds_without_core
from fvslam_graph.runs.results import Relatives, Run, ending_info

SMOOTHED, SMOOTHED_KITTI = "trajectory_smoothed.tum", "trajectory_smoothed.kitti"
GROUND_TRUTH = "ground_truth.tum"
CONFIG, METRICS_FILE, REFERENCE = "config.yaml", "metrics.json", "reference.tum"
GNSS_FILE = "gnss.csv"
GRAPH_FILES = (G2O, LANDMARKS_PLY, FACTORS, VALUES)
FIGURES = ("trajectory", "error", "drift", "covariance", "nees", "speed", "features")

ROUNDING = 1e-6  # share of its largest variance by which a covariance may be negative
UNFINISHED = "unfinished"  # a folder for a new run where a finished one is kept until that, too, is finished

# Everything that a run, its evaluation and its plots leave in the folder; a new run into the same folder removes it.
_OURS = (
    *(ONLINE, ONLINE_KITTI, SMOOTHED, SMOOTHED_KITTI, GROUND_TRUTH, FRAMES, COVARIANCES, POSES, CONFIG, INFO),
    *GRAPH_FILES,
    *(LANDMARKS, GNSS_FILE, METRICS_FILE, REFERENCE),
    *(f"{error}_{part}.zip" for error in ("ape", "rpe", "rpe_1m") for part in ("trans", "rot")),
    *(f"row_{align}.json" for align in ("none", "origin", "se3", "sim3")),
    *(f"plot_{name}.{kind}" for name in FIGURES for kind in ("png", "pdf")),
    f"plot_landmarks_{6 * '[0-9]'}.png",
)

_log = logging.getLogger(__name__)
_T = TypeVar("_T")


class RunWriter:
    """Writes a run folder; a context manager around the loop over the frames.

    Each frame is a line of `trajectory_online.tum` and `frames.csv`, its landmarks are lines of `landmarks.csv`, and
    its covariances are in `poses.bin`. `run.json` says "running" until the end, then "finished", "interrupted" or
    "failed: ...". The end also brings `trajectory_online.kitti`, `covariances.npz` in place of `poses.bin`, and in mode
    `graph` the smoothed trajectory and the graph.

    Args:
        folder: Created. A finished run that it holds is kept until this one is finished, too, which is in the folder
            `unfinished` of it until then; any other run is replaced.
        config: The effective settings.
        metadata: Goes into run.json. Known to evaluation and plots: `sequence` (name), `frames` (how many the sequence
            has), `mode`, `scale_source`, `down` (3,), the direction of gravity in the first camera frame (None:
            unknown), and `source`, what `open_sequence` takes to open the recording again; and to exports, `camera`.
        ground_truth: Kept with the run, so that it can be evaluated without the recording,
        gnss: and fixes of a receiver, so that it can be put on a map.
        finish: Called at the end, also of a run that is interrupted: what all frames together say.

    Raises:
        ResultsError: The folder holds something else than a run, is in use, or cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        config: BaseModel,
        metadata: Mapping[str, Any],
        ground_truth: Trajectory | None = None,
        gnss: SensorSeries | None = None,
        finish: Callable[[], Ending | None] = lambda: None,
    ) -> None:
        self.folder = folder
        self._config = config
        self._metadata = dict(metadata)
        self._ground_truth = ground_truth
        self._gnss = gnss
        self._finish = finish

    def __enter__(self) -> RunWriter:
        self._begin, self._cpu, self._waited = time.perf_counter(), time.process_time(), seconds_without_core()
        forget_peak_memory()
        with ExitStack() as stack:
            stack.enter_context(claimed(self.folder, FolderKind.RUN))
            self._place = self.folder
            if is_finished(self.folder):
                self._place = self.folder / UNFINISHED
                stack.enter_context(claimed(self._place, FolderKind.RUN))
            with writing(self._place):
                _clear(self._place)
                settings = yaml.safe_dump(self._config.model_dump(mode="json"), sort_keys=False)
                write_file(self._place / CONFIG, settings)
                if self._ground_truth is not None:
                    _write_tum(self._place / GROUND_TRUTH, self._ground_truth)
                if self._gnss is not None:
                    with replacing(self._place / GNSS_FILE) as temporary:
                        write_fixes(temporary, self._gnss)
                self._files = FrameFiles(self._place, stack)
                self._write_info("running")  # last: from here on, this is a run, and all that one has is there
            self._stack = stack.pop_all()
        return self

    def add(self, result: FrameResult) -> None:
        """Write one frame; it is in the files when this returns."""
        self._files.add(result)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with self._stack:
            try:
                with writing(self._place):
                    self._files.close()
                    if kind is None or issubclass(kind, KeyboardInterrupt):
                        self._write_ending()
                    write_arrays(self._place)
                    self._write_info(_status(error))
                    if kind is None and self._place != self.folder:
                        self._replace_finished()
            except BaseException as second:
                with suppress(OSError):  # it says "running" then
                    self._write_info(_status(error or second))
                if error is None:
                    raise
        if kind is not None and self._place != self.folder:
            _log.warning("%s keeps the finished run that it held; the new one is in %s", self.folder, self._place)

    def _write_ending(self) -> None:
        ending = self._finish()
        self._metadata |= ending_info(ending)
        if ending is not None and ending.smoothed is not None:
            _write_tum(self._place / SMOOTHED, ending.smoothed)
            write_file(self._place / SMOOTHED_KITTI, "".join(map(kitti_line, ending.smoothed.poses)))
            ending.write(self._place)

    def _replace_finished(self) -> None:
        """Take the place of the finished run that was here; `run.json` goes first and comes last."""
        (self.folder / INFO).unlink()
        _clear(self.folder)
        for path in sorted(self._place.iterdir(), key=lambda path: path.name == INFO):
            if path.name not in (MARK, LOCK):
                path.replace(self.folder / path.name)
        disown(self._place)

    def _write_info(self, status: str) -> None:
        info = {"status": status, **self._metadata, **provenance(), "totals": self._totals()}
        write_json(self._place / INFO, info)

    def _totals(self) -> dict[str, Any]:
        return self._files.totals() | {
            "seconds": (seconds := time.perf_counter() - self._begin),
            "cpu_seconds": time.process_time() - self._cpu,
            "waited": (seconds_without_core() - self._waited) / seconds,  # share of that time, for a core
            "peak_memory_mb": peak_memory_mb(),
        }


def read_run(folder: Path) -> Run:
    """Read a run folder, also of a run that goes on or was killed: its last, incomplete line is left out.

    Raises:
        ResultsError: The folder is not that of a run, or one of its files is damaged.
        TrajectoryError: One of its trajectories is damaged.
    """
    if kind_of(folder) is not FolderKind.RUN or not (folder / INFO).is_file():
        raise ResultsError(f"{folder} is not the folder of a run: it has no {INFO}; give the output folder of a run")
    info = _parsed(folder / INFO, _read_info)
    frames = _parsed(folder / FRAMES, _read_frames)
    stamps = frames.get("stamp", np.empty(0))
    written = Trajectory.read_tum(folder / ONLINE, unfinished=True) if len(stamps) else Trajectory(stamps, ())
    relatives, covariances = None, None
    if kept := [folder / name for name in (COVARIANCES, POSES) if (folder / name).exists()]:
        relatives, covariances = _parsed(kept[0], _read_covariances)
    # Where the run was stopped between two writes, one file is a frame ahead of another.
    count = min(len(written), len(stamps), len(stamps if relatives is None else relatives.previous))
    if not np.allclose(written.stamps[:count], stamps[:count], rtol=0, atol=1e-6):
        raise ResultsError(f"{folder / ONLINE} and {FRAMES} are not of the same frames, the run must be done again")
    return Run(
        name=folder.resolve().name,
        online=Trajectory(written.stamps[:count], written.poses[:count], notes=written.notes),
        smoothed=_read_optional(folder / SMOOTHED),
        ground_truth=_read_optional(folder / GROUND_TRUTH),
        frames={name: column[:count] for name, column in frames.items()},
        config=_parsed(folder / CONFIG, _read_config),
        info=info,
        relatives=relatives and relatives.first(count),
        pose_covariances=None if covariances is None else covariances[:count],
        gnss=read_fixes(folder / GNSS_FILE) if (folder / GNSS_FILE).exists() else None,
        folder=folder,
    )


def is_finished(folder: Path) -> bool:
    """Whether it is the folder of a run that came to its end."""
    try:
        return kind_of(folder) is FolderKind.RUN and _read_info(folder / INFO)["status"] == "finished"
    except (ResultsError, ValueError):
        return False


def _clear(folder: Path) -> None:
    """Remove what a run has left, and what was about to be written when it was killed."""
    for pattern in _OURS:
        for path in (*folder.glob(pattern), *folder.glob(f"writing_{pattern}")):
            path.unlink()


def _status(error: BaseException | None) -> str:
    if error is None:
        return "finished"
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    return f"failed: {str(error) or type(error).__name__}"


def _write_tum(path: Path, trajectory: Trajectory) -> None:
    with replacing(path) as temporary:
        trajectory.write_tum(temporary)


def _parsed(path: Path, parse: Callable[[Path], _T]) -> _T:
    try:
        return parse(path)
    except ResultsError:
        raise
    except Exception as error:  # what the readers of csv, yaml, json and npz raise at damaged files has no common base
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ResultsError(f"{path} cannot be read, the run must be done again: {reason}") from None


def _no_zero(direction: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(direction):
        raise ValueError("it has no direction")
    return direction


class _Info(BaseModel):
    """The entries of run.json that readers rely on; it holds more."""

    model_config = ConfigDict(strict=True)

    status: str
    sequence: str | None = None
    mode: str | None = None
    scale_source: str | None = None
    smoothed: str | None = None
    frames: NonNegativeInt | None = None
    down: Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat], AfterValidator(_no_zero)] | None = None
    source: dict[str, Any] | None = None
    camera: Camera | None = None
    placement: dict[str, Any] | None = None
    totals: dict[str, Any] = {}


def _read_info(path: Path) -> dict[str, Any]:
    text = read_text(path, ResultsError)
    info: dict[str, Any] = json.loads(text)
    try:
        _Info.model_validate_json(text)
    except ValidationError as error:
        raise ValueError(complaint(error, _Info, "entry")) from None
    except CameraError as error:
        raise ValueError(error) from None
    return info


def _read_config(path: Path) -> dict[str, Any]:
    return read_yaml_mapping(path, ResultsError)


def _read_frames(path: Path) -> dict[str, NDArray[Any]]:
    text = read_text(path, ResultsError, OWN_MAX_SIZE)
    reader = csv.DictReader(text[: text.rfind("\n") + 1].splitlines(), restval="missing")
    rows = list(reader)
    types = {"index": np.int64, "status": np.str_}
    names = reader.fieldnames or ()
    if names and not {"index", "stamp", "status"} <= set(names):
        raise ValueError("it has no columns index, stamp and status")
    frames: dict[str, NDArray[Any]] = {
        name: np.array([row[name] for row in rows]).astype(types.get(name, np.float64)) for name in names
    }
    if unknown := set(frames.get("status", ())) - set(Status):
        raise ValueError(f"there is no status '{min(unknown)}'")
    return frames


def _read_covariances(path: Path) -> tuple[Relatives, NDArray[np.float64]]:
    """The relative motions, and the covariances (N, 6, 6) of the poses."""
    arrays = read_arrays(path)
    found, of_poses = Relatives(*(arrays[field.name] for field in fields(Relatives))), arrays["pose_covariances"]
    count = len(found.previous)
    if (found.previous.shape, found.prev_T_cur.shape, found.covariances.shape, of_poses.shape) != (
        (count,),
        (count, 4, 4),
        (count, 6, 6),
        (count, 6, 6),
    ) or not all(0 <= previous <= frame for frame, previous in enumerate(found.previous)):
        raise ValueError("its arrays do not fit each other")
    if not np.isfinite(found.prev_T_cur).all():
        raise ValueError("it has a motion that is not finite")
    for covariances in (found.covariances, of_poses):
        known = np.flatnonzero(np.isfinite(covariances).all(axis=(1, 2)))
        values = np.linalg.eigvalsh(covariances[known])
        if negative := known[values[:, 0] < -ROUNDING * np.abs(values).max(axis=1)].tolist():
            raise ValueError(f"the covariance of frame {negative[0]} has a negative variance")
    return found, of_poses


def _read_optional(path: Path) -> Trajectory | None:
    return Trajectory.read_tum(path) if path.exists() else None
