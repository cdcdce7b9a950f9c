"""A sparse model of COLMAP as text: one camera, an image a pose, and the landmarks of the factor graph.

COLMAP's poses are camera_T_world, its quaternions begin with w, and the centre of its first pixel is (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Distortion
from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.frame_result import VALUES
from fvslam_graph.core.text_files import OWN_MAX_SIZE, read_text
from fvslam_graph.runs.export.poses import ExportedPoses
from fvslam_graph.runs.frame_files import LANDMARKS
from fvslam_graph.runs.landmark_table import Observations, read_observations
from fvslam_graph.runs.ownership import INFO
from fvslam_graph.runs.results import Run

FIRST_PIXEL = 0.5  # where COLMAP has its centre
MIN_TRACK = 2  # images that show a point
GREY = 128


def write(path: Path, poses: ExportedPoses) -> tuple[str, ...]:
    """Write cameras.txt, images.txt and points3D.txt; the images are 000000.png, ... by their frames.

    Landmarks come with the smoothed poses, which they were estimated with; so does the calibration that they tell.

    Raises:
        ResultsError: The run does not know its camera, or its landmarks cannot be read.
    """
    camera, model = _camera(poses.run), None
    if poses.smoothed and poses.run.folder is not None:
        camera = _refined(camera, poses.run)
        model = _landmarks(poses.run.folder, camera, poses)
    path.mkdir()
    (path / "cameras.txt").write_text(_camera_line(camera))
    (path / "images.txt").write_text("".join(_image_lines(poses, model)))
    (path / "points3D.txt").write_text("" if model is None else "".join(_point_lines(model)))
    if model is None:
        return ("there are no points: landmarks belong to the smoothed poses of a run in mode graph",)
    return (f"{len(model.points)} landmarks",)


@dataclass(frozen=True)
class _Points:
    """Landmarks of the graph and where they were seen.

    Attributes:
        points: Position in the world (3,), metres, by the landmark's id.
        seen: In the exported frames, in the order of frames; without those that no camera can have seen.
        errors: (K,) pixels between observation and projection.
    """

    points: dict[int, NDArray[np.float64]]
    seen: Observations
    errors: NDArray[np.float64]


def _camera(run: Run) -> Camera:
    if not (numbers := run.info.get("camera")):
        raise ResultsError(f"{run.name} does not know its camera, as it is of an earlier version; run it again")
    return Camera(**numbers)


def _refined(camera: Camera, run: Run) -> Camera:
    """The camera as landmarks tell it, where they do: with a radial distortion that is left in the images."""
    found = run.info.get("calibration")
    if not isinstance(found, dict):
        return camera
    try:
        fx, k1 = float(found["focal_length"]), float(found["k1"])
    except (KeyError, TypeError, ValueError):
        raise ResultsError(f"{run.name} has a calibration in {INFO} that cannot be read; run it again") from None
    fy = fx * camera.fy / camera.fx
    return replace(camera, fx=fx, fy=fy, distortion=Distortion.RADTAN, coefficients=(k1, 0.0, 0.0, 0.0))


def _landmarks(folder: Path, camera: Camera, poses: ExportedPoses) -> _Points | None:
    """What the graph has in its files; None where that is no landmarks."""
    if not (folder / VALUES).exists() or not (folder / LANDMARKS).exists():
        return None
    values = gtsam.Values()
    try:
        values.deserialize(read_text(folder / VALUES, ResultsError, OWN_MAX_SIZE))
        seen = read_observations(folder / LANDMARKS)
    except (RuntimeError, ValueError) as error:
        raise ResultsError(f"{folder} has landmarks that cannot be read, run it again: {error}") from None
    known = {n: gtsam.symbol("l", n) for n in np.unique(seen.ids).tolist()}
    points = {n: values.atPoint3(key) for n, key in known.items() if values.exists(key)}
    seen = seen.select(np.isin(seen.ids, list(points)) & np.isin(seen.frames, poses.frames))
    errors = np.full(len(seen.ids), np.nan)
    for frame, pose in zip(poses.frames, poses.trajectory.poses, strict=True):
        rows = np.flatnonzero(seen.frames == frame)
        world = np.array([points[n] for n in seen.ids[rows].tolist()]).reshape(-1, 3)
        expected = camera.project(pose.transformTo(world.T).T) if len(rows) else np.empty((0, 2))
        errors[rows] = np.linalg.norm(seen.pixels[rows] - expected, axis=1)
    ids, counts = np.unique(seen.ids[np.isfinite(errors)], return_counts=True)
    kept = ids[counts >= MIN_TRACK]
    rows = np.isfinite(errors) & np.isin(seen.ids, kept)
    return _Points({n: points[n] for n in kept.tolist()}, seen.select(rows), errors[rows])


def _camera_line(camera: Camera) -> str:
    numbers = [camera.fx, camera.fy, camera.cx + FIRST_PIXEL, camera.cy + FIRST_PIXEL, *camera.coefficients]
    model = "PINHOLE" if camera.distortion is Distortion.NONE else "OPENCV"
    return f"1 {model} {camera.width} {camera.height} {_joined(numbers)}\n"


def _image_lines(poses: ExportedPoses, model: _Points | None) -> list[str]:
    """Two lines an image: its pose and name, then pixels and numbers of the points in it."""
    lines = []
    for frame, pose in zip(poses.frames.tolist(), poses.trajectory.poses, strict=True):
        camera_T_world = pose.inverse()
        q = camera_T_world.rotation().toQuaternion()
        numbers = [q.w(), q.x(), q.y(), q.z(), *camera_T_world.translation()]
        pixels = []
        if model is not None:
            rows = model.seen.frames == frame
            pixels = [
                f"{_joined(pixel + FIRST_PIXEL)} {n + 1}"
                for pixel, n in zip(model.seen.pixels[rows], model.seen.ids[rows].tolist(), strict=True)
            ]
        lines.append(f"{frame + 1} {_joined(numbers)} 1 {frame:06d}.png\n{' '.join(pixels)}\n")
    return lines


def _point_lines(model: _Points) -> list[str]:
    """A line a point: position, colour, mean error, and in which images it is which of the pixels."""
    seen = model.seen
    starts = np.searchsorted(seen.frames, seen.frames)  # rows are in the order of frames
    places = np.arange(len(starts)) - starts
    lines = []
    for n, point in model.points.items():
        rows = np.flatnonzero(seen.ids == n)
        track = " ".join(f"{seen.frames[row] + 1} {places[row]}" for row in rows)
        lines.append(f"{n + 1} {_joined(point)} {GREY} {GREY} {GREY} {model.errors[rows].mean():.6g} {track}\n")
    return lines


def _joined(numbers: NDArray[np.float64] | list[float]) -> str:
    return " ".join(f"{number:.17g}" for number in numbers)
