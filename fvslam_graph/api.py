"""The package from Python: an estimator to hold in the hand, whole runs, their evaluation, export and comparison."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Distortion, Rectifier
from fvslam_graph.core.choices import Mode, ScaleSource
from fvslam_graph.core.config import Config, load_config
from fvslam_graph.core.errors import ConfigError, EstimationError
from fvslam_graph.core.frame_result import Ending, FrameResult
from fvslam_graph.core.modes import MODES
from fvslam_graph.core.sensors import Fix
from fvslam_graph.core.sequence import Frame, Ground, Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.estimator import begin

if TYPE_CHECKING:
    from fvslam_graph.core.outside import Method
    from fvslam_graph.evaluation.metrics import Evaluation
    from fvslam_graph.runs.export.formats import Export
    from fvslam_graph.runs.results import Run
    from fvslam_graph.study.results import StudyResults
    from fvslam_graph.study.spec import ComparisonOptions


class Estimator:
    """Estimates the pose of a camera, image by image, as they come.

        estimator = Estimator(camera, mode="average", ground=Ground.below(height=1.65))
        for stamp, image in live_camera:
            result = estimator.step(image, stamp)
            use(result.pose.mean, result.pose.covariance, result.status)
        ending = estimator.finish()

    The poses are those of `run` on the same images, bit by bit.

    Args:
        camera: As built: images are rectified where it has a distortion.
        mode: "vo", "vslam", "average", "intersection" or "graph", or what another package adds: its name, or a path
            such as "mypkg:MyRule".
        ground: What is known of the ground below; without it, the scale is relative.
        preset: "paper" or "tuned".
        settings: What differs from the preset, such as {"graph.lag": 5.0}, which bounds the memory of mode "graph".
        seed: Of all random numbers.

    Raises:
        ConfigError: A setting is unknown or out of range.
    """

    def __init__(
        self,
        camera: Camera,
        mode: str = "graph",
        ground: Ground | None = None,
        preset: str = "tuned",
        settings: Mapping[str, Any] | None = None,
        seed: int = 0,
    ) -> None:
        config = _config(preset, mode, seed, settings)
        if config.scale.source is ScaleSource.ORACLE:
            raise ConfigError("the scale source 'oracle' needs the ground truth of a recording; choose another source")
        if ground is None and config.scale.source is ScaleSource.PLANE:
            config = config.in_relative_scale()
        self.camera = camera
        self._ground = ground
        self._takes_positions = config.mode == Mode.GRAPH and not config.scale.relative
        self._rectify = None if camera.distortion is Distortion.NONE else Rectifier(camera, camera.undistorted())
        self._estimator = begin(camera.undistorted(), config, ground)
        self._count, self._stamp, self._finished = 0, -math.inf, False

    def step(
        self,
        image: NDArray[np.uint8] | None,
        stamp: float,
        height: float | None = None,
        position: Iterable[float] | None = None,
        gravity: Iterable[float] | None = None,
    ) -> FrameResult:
        """Estimate the pose of the next image.

        Args:
            image: (H, W) grey, of the camera's size; None where there is none at this time, which gets the status
                SKIPPED and a pose by the motion model.
            stamp: Seconds, later than the last.
            height: Metres from the camera to the ground, as measured now; by default what `ground` says.
            position: Of the camera by GNSS, as measured now: latitude, longitude (degrees, WGS84), altitude (m), and
                the standard deviation along each axis (m). For mode "graph" with a known ground.
            gravity: (3,) direction of gravity in the camera, down, by an inertial unit. It stands for the normal of the
                ground in this frame, and holds roll and pitch in mode "graph".

        Raises:
            EstimationError: The image, its stamp or a measurement cannot be that of a next frame, or `finish` was
                called.
        """
        if self._finished:
            raise EstimationError("the estimator is finished; begin with a new one")
        if not (math.isfinite(stamp) and stamp > self._stamp):
            raise EstimationError(f"stamps are seconds that increase; {stamp:g} comes after {self._stamp:g}")
        index, ground = self._count, self._ground
        frame = Frame(index, float(stamp), self._usable(image))
        if ground is not None:
            height = float(ground.heights[min(index, len(ground.heights) - 1)]) if height is None else height
            frame = replace(frame, height=height, height_sigma=ground.height_sigma)
        fixes = () if position is None else (self._fix(frame.stamp, tuple(position)),)
        down = None if gravity is None else _direction(tuple(gravity))
        result = self._estimator.step(replace(frame, fixes=fixes, gravity=down))
        self._count, self._stamp = index + 1, float(stamp)
        return result

    def finish(self) -> Ending | None:
        """All that the frames together say, and the factor graph to be written; None in modes without a graph."""
        if self._finished:
            raise EstimationError("the estimator is finished already")
        self._finished = True
        return self._estimator.finish()

    def _fix(self, stamp: float, position: tuple[float, ...]) -> Fix:
        if not self._takes_positions:
            raise EstimationError("positions are used in mode graph, where a known ground gives metres")
        good = len(position) == 4 and all(map(math.isfinite, position))
        if not (good and abs(position[0]) <= 90 and abs(position[1]) <= 180 and position[3] > 0):
            raise EstimationError(
                f"a position is latitude, longitude, altitude and a standard deviation above zero, not {position}"
            )
        return Fix(stamp, np.array(position[:3]), np.full(3, position[3]))

    def _usable(self, image: NDArray[np.uint8] | None) -> NDArray[np.uint8] | None:
        """The image rectified, or a copy of it: a driver may write the next one into the same memory."""
        if image is None:
            return None
        shape = (self.camera.height, self.camera.width)
        if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.shape != shape:
            what = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
            raise EstimationError(f"an image of this camera is an array of uint8 {shape}, not {what}")
        return image.copy() if self._rectify is None else self._rectify(image)


def run(
    sequence: Sequence | str | Path,
    mode: str = "vo",
    preset: str = "tuned",
    settings: Mapping[str, Any] | None = None,
    seed: int = 0,
    out: str | Path | None = None,
) -> Run:
    """Run an estimator on a sequence.

    Args:
        sequence: As `open_sequence` returns it, or what it takes: a folder, a video or `synthetic:uav`.
        mode: "vo", "vslam", "average", "intersection" or "graph", or what another package adds, as for `Estimator`.
        preset: "paper" or "tuned".
        settings: What differs from the preset, such as {"scale.source": "map"}.
        seed: Of all random numbers.
        out: Folder of the run; without it, nothing is written.

    Returns:
        Trajectories, covariances, a table of all frames, and the ground truth that `evaluate` takes.

    Raises:
        FvslamError: One sentence on what is missing, unknown or out of range.
    """
    from fvslam_graph.pipeline import run_sequence
    from fvslam_graph.sequences.open import open_sequence

    recording = sequence if isinstance(sequence, Sequence) else open_sequence(sequence)
    return run_sequence(recording, _config(preset, mode, seed, settings), None if out is None else Path(out))


def evaluate(
    estimated: Run | Trajectory | str | Path,
    reference: Trajectory | str | Path | None = None,
    align: str = "se3",
    time_offset: float = 0.0,
) -> Evaluation:
    """Compare a trajectory with its ground truth: APE and RPE (evo), drift (KITTI), NEES.

    Args:
        estimated: A run, a trajectory, a run folder, or a file in TUM's, KITTI's or the ASL layout.
        reference: A trajectory or its file; a run knows its own.
        align: "none", "origin", "se3" or "sim3".
        time_offset: Seconds, added to the stamps of the estimate to get those of the reference (evo's --t_offset).

    Raises:
        FvslamError: A file cannot be read, there is no reference, or the two have no time in common.
    """
    from fvslam_graph.evaluation.runs import evaluation_of

    return evaluation_of(estimated, reference, align, time_offset)


def export(
    run: Run | str | Path,
    format: str,
    out: str | Path,
    smoothed: bool = False,
    origin: Iterable[float] | None = None,
    gnss: str | Path | None = None,
) -> Export:
    """Write the poses of a run, with their covariances, in the format of another program.

    Args:
        run: A run or its folder.
        format: "csv", "ros2", "euroc", "colmap", "g2o", "kml", "gpx" or "geojson".
        out: A file, or for ros2, euroc and colmap a folder, that does not exist yet.
        smoothed: The poses by all measurements (mode graph), which have no covariances, in place of the online ones.
        origin: Latitude, longitude (degrees, WGS84), altitude (m) and, if given, heading (degrees clockwise from
            north) of the first camera, for kml, gpx and geojson.
        gnss: CSV file of fixes (stamp, latitude, longitude, altitude) that the path is aligned with, likewise, in place
            of those that the recording has.

    Returns:
        `path`, and `notes` on what its reader should know.

    Raises:
        FvslamError: One sentence on what is missing, unknown or in the way.
    """
    from fvslam_graph.runs.export.formats import export_run
    from fvslam_graph.runs.run_folder import read_run

    exported = read_run(Path(run)) if isinstance(run, str | Path) else run
    place = None if origin is None else tuple(origin)
    return export_run(exported, format, Path(out), smoothed, place, None if gnss is None else Path(gnss))


def compare(
    sequence: Sequence | str | Path,
    modes: Iterable[str | Method] = MODES,
    seeds: int | Iterable[int] = 5,
    out: str | Path | None = None,
    workers: int = 1,
    **options: Unpack[ComparisonOptions],
) -> StudyResults:
    """Run several modes on one sequence, over several seeds, beside estimators and trajectories of others.

        compare("synthetic:uav", ["vo", "graph", my_function], external={"ORB-SLAM3": "orbslam3.tum"})

    A function is called with the sequence and a seed, and returns a `Trajectory`, or yields a `FrameResult` for each
    frame. One that cannot be imported by its name runs in this process, each time anew.

    Args:
        sequence: A folder, a video, `synthetic:uav`, or a `Sequence`.
        modes: Which; as for `run`, or functions.
        seeds: How many, or which.
        out: Folder for runs, tables, figures and report; runs/comparison-on-... if not given. Runs that it holds are
            kept.
        workers: Processes at once; with several, times are those of runs that share the machine.
        options: preset ("paper" or "tuned"); settings, what differs from the preset, where a list of values makes a
            variant of each; external, trajectory files (see `fvslam_graph.study.external.external_run`) or functions
            by a name of their own; systems, commands of other programs by their name, such as
            "orbslam3 {images} {times} {camera} {out}" (see `fvslam_graph.study.systems.System`); system_limit, seconds
            after which one is killed; align ("none", "origin", "se3" or "sim3", by default the last).

    Returns:
        `table` is a pandas DataFrame with a row for each run, `summary()` the table of medians.

    Raises:
        FvslamError: One sentence on what is missing, unknown or out of range.
    """
    from fvslam_graph.study.run import run_study
    from fvslam_graph.study.spec import comparison, default_folder

    study = comparison(sequence, modes, seeds, **options)
    return run_study(study, default_folder(study) if out is None else Path(out), workers)


def _direction(vector: tuple[float, ...]) -> NDArray[np.float64]:
    """The unit vector (3,) along a vector."""
    if len(vector) != 3 or not all(map(math.isfinite, vector)) or not any(vector):
        raise EstimationError(f"gravity is a direction of three numbers, not {vector}")
    direction: NDArray[np.float64] = np.array(vector) / np.linalg.norm(vector)
    return direction


def _config(preset: str, mode: str, seed: int, settings: Mapping[str, Any] | None) -> Config:
    changes = [f"{name}={json.dumps(value)}" for name, value in (settings or {}).items()]
    return load_config(preset, settings=[f"mode={mode}", f"seed={seed}", *changes])
