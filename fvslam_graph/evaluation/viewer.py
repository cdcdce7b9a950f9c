"""A run in Rerun's viewer or its files: images with tracks and landmarks, paths, ellipsoids and scale over time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Image
from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.extras import require
from fvslam_graph.core.frame_result import FrameResult
from fvslam_graph.core.sequence import Frame, Sequence
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.core.trajectory import Status, Trajectory
from fvslam_graph.evaluation.plots.landmarks import OUTCOMES
from fvslam_graph.runs.landmark_table import landmark_columns, landmark_points

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

VIEWER = "viewer"  # in place of the name of a file
SUFFIX = ".rrd"

CAMERA, IMAGE = "world/camera", "world/camera/image"
TRACKS, SEEN = f"{IMAGE}/tracks", f"{IMAGE}/landmarks"
POINTS, POINT_ELLIPSOIDS = "world/landmarks", "world/landmarks/covariances"
ONLINE, ELLIPSOID, SMOOTHED, TRUTH = "world/online", "world/position", "world/smoothed", "world/ground_truth"
SCALE, FEATURES, STATUS = "scale", "features", "status"
FRAME, TIME = "frame", "time"

COLOURS = {ONLINE: "#0072B2", ELLIPSOID: "#56B4E9", SMOOTHED: "#D55E00", TRUTH: "#888888", TRACKS: "#F0E442"}
SIGMAS_SHOWN = 2.0  # of the ellipsoids, as in the plots
JPEG_QUALITY = 80  # percent
FIRST_DATE = 1e8  # seconds; stamps from here on are dates
SCALE_COLUMNS = ("scale", "scale_sigma", "map_scale_sigma")
FEATURE_COLUMNS = ("tracks", "inliers", "landmarks", "measured")

_EXPECTED = ("expected_u", "expected_v")

Columns = dict[str, NDArray[Any]]


class Viewer:
    """Hands results on to Rerun, frame by frame; a context manager.

    A thread does so while the next frame is estimated: most of the work is compression, outside of Python.

    Args:
        target: A file to write, NAME.rrd, or "viewer", which is opened.
        name: Of the recording.
        camera: Of the rectified images.
        truth: Ground truth, world_T_camera; shown in the world of the estimate, from the first frame that it covers.

    Raises:
        FvslamError: Rerun is not installed.
        ResultsError: The file exists, has another suffix, or cannot be written.
    """

    def __init__(self, target: str, name: str, camera: Camera, truth: Trajectory | None = None) -> None:
        require("rerun")
        import rerun

        self._rr = rerun
        self._truth = truth
        self._image: Image | None = None
        self._last: gtsam.Pose3 | None = None
        self._status: Status | None = None
        self._worker, self._shown = ThreadPoolExecutor(max_workers=1), Future[None]()
        self._shown.set_result(None)
        self._recording = rerun.RecordingStream("fvslam")
        for automatic in (self._recording.set_log_time_enabled, self._recording.set_log_tick_enabled):
            automatic(False)
        if target == VIEWER:
            self._recording.spawn(default_blueprint=_blueprint())
        else:
            self._save(Path(target).expanduser())
        self._recording.send_recording_name(name)
        self._describe(camera)

    def __enter__(self) -> Viewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._worker.shutdown()
        self._recording.flush()
        self._recording.disconnect()
        if error is None:
            self._shown.result()

    def watched(self, sequence: Sequence) -> Sequence:
        """The recording, of which the image that was read last is that of the next result."""
        return replace(sequence, load=lambda index: self.see(sequence.load(index)))

    def see(self, image: Image | None) -> Image | None:
        """Remember the image of the next result, and hand it on."""
        self._image = image
        return image

    def seen(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Hand frames on, and remember their images."""
        for frame in frames:
            self.see(frame.image)
            yield frame

    def watch(self, results: Iterable[FrameResult]) -> Iterator[FrameResult]:
        """Show results, with the image that was seen last, and hand them on."""
        for result in results:
            self.show(result, None if result.slam is None else landmark_columns(result.slam))
            yield result

    def show(self, result: FrameResult, landmarks: Columns | None = None) -> None:
        """Show the result of a frame, once the one before is shown.

        Args:
            result: Its pose, tracks and measures.
            landmarks: Columns of landmarks.csv; None where visual SLAM did not run.
        """
        self._shown.result()
        self._shown = self._worker.submit(self._show, result, self._image, landmarks)

    def end(self, smoothed: Trajectory | None) -> None:
        """Show the path by all measurements, where there is one."""
        if smoothed is not None:
            self._recording.log(SMOOTHED, self._rr.LineStrips3D([smoothed.positions]), static=True)

    def _show(self, result: FrameResult, image: Image | None, landmarks: Columns | None) -> None:
        rr, log, pose = self._rr, self._recording.log, result.pose.mean
        self._recording.set_time(FRAME, sequence=result.index)
        when: dict[str, Any] = {"timestamp" if result.stamp > FIRST_DATE else "duration": result.stamp}
        self._recording.set_time(TIME, **when)
        log(CAMERA, rr.Transform3D(translation=pose.translation(), mat3x3=pose.rotation().matrix()))
        if self._last is not None:
            log(ONLINE, rr.LineStrips3D([[self._last.translation(), pose.translation()]]))
        log(ELLIPSOID, self._ellipsoids(pose, np.zeros((1, 3)), result.pose.covariance[None, 3:, 3:]))
        self._show_image(image, result.tracks)
        self._show_landmarks(pose, landmarks)
        for entity, names in ((SCALE, SCALE_COLUMNS), (FEATURES, FEATURE_COLUMNS)):
            log(entity, rr.Scalars([result.measures.get(name, math.nan) for name in names]))
        if result.status is not self._status:
            log(STATUS, rr.TextLog(f"frame {result.index}: {result.status}", level=_level(result.status)))
        self._last, self._status = pose, result.status
        self._show_truth(result.stamp, pose)

    def _save(self, path: Path) -> None:
        if path.suffix != SUFFIX:
            raise ResultsError(f"Rerun's files end with {SUFFIX}; give such a name, or '{VIEWER}', not '{path}'")
        if path.exists():
            raise ResultsError(f"{path} exists and is not overwritten; give another name, or remove it")
        try:
            self._recording.save(path, default_blueprint=_blueprint())
        except (OSError, RuntimeError) as error:
            raise ResultsError(f"{path} cannot be written: {error}") from None

    def _describe(self, camera: Camera) -> None:
        """What holds for all frames: axes, the camera, colours, classes of landmarks, names of curves."""
        rr, log = self._rr, self._recording.log
        log("world", rr.ViewCoordinates.RIGHT_HAND_Y_DOWN, static=True)
        pinhole = rr.Pinhole(
            image_from_camera=camera.K, resolution=[camera.width, camera.height], camera_xyz=rr.ViewCoordinates.RDF
        )
        log(IMAGE, pinhole, static=True)
        classes = [
            rr.AnnotationInfo(id=number, label=label, color=_rgb(colour))
            for number, (colour, _, label) in enumerate(OUTCOMES.values())
        ]
        log("world", rr.AnnotationContext(classes), static=True)
        paths = dict.fromkeys((ONLINE, SMOOTHED, TRUTH), rr.LineStrips3D)
        for entity, kind in (paths | {ELLIPSOID: rr.Ellipsoids3D, TRACKS: rr.Arrows2D}).items():
            log(entity, kind.from_fields(colors=[_rgb(COLOURS[entity])]), static=True)
        for entity, names in ((SCALE, SCALE_COLUMNS), (FEATURES, FEATURE_COLUMNS)):
            log(entity, rr.SeriesLines(names=[name.replace("_", " ") for name in names]), static=True)

    def _show_image(self, image: Image | None, tracks: Tracks) -> None:
        rr, log = self._rr, self._recording.log
        if image is None:
            log(IMAGE, rr.Clear(recursive=False))
        else:
            _, jpeg = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))
            log(IMAGE, rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg"))
        log(TRACKS, rr.Arrows2D(origins=tracks.keyframe, vectors=tracks.current - tracks.keyframe))

    def _show_landmarks(self, pose: gtsam.Pose3, landmarks: Columns | None) -> None:
        """Landmarks in the image, which only holds for this frame, and in the world, where they stay."""
        rr, log = self._rr, self._recording.log
        if landmarks is None:
            log(SEEN, rr.Points2D([]))
            return
        classes = np.array([list(OUTCOMES).index(name) if name in OUTCOMES else -1 for name in landmarks["outcome"]])
        found, expected = (np.column_stack([landmarks[n] for n in names]) for names in ("uv", _EXPECTED))
        pixels = np.where(np.isnan(found), expected, found)
        shown = (classes >= 0) & np.isfinite(pixels[:, 0])
        log(SEEN, rr.Points2D(pixels[shown], class_ids=classes[shown], radii=rr.Radius.ui_points(3)))
        points, covariances = landmark_points(landmarks)
        kept = (classes >= 0) & np.isfinite(points[:, 0])
        points, covariances, classes = points[kept], covariances[kept], classes[kept]
        positions = points @ pose.rotation().matrix().T + pose.translation()
        log(POINTS, rr.Points3D(positions, class_ids=classes, radii=rr.Radius.ui_points(3)))
        log(POINT_ELLIPSOIDS, self._ellipsoids(pose, points, covariances, class_ids=classes))

    def _ellipsoids(
        self, pose: gtsam.Pose3, centres: NDArray[np.float64], covariances: NDArray[np.float64], **looks: Any
    ) -> rr.Ellipsoids3D:
        """Ellipsoids of covariances (N, 3, 3) around centres (N, 3) in the camera, m, brought into the world."""
        rotation = pose.rotation().matrix()
        values, axes = np.linalg.eigh(covariances)
        axes = rotation @ axes * np.linalg.det(axes)[:, None, None]  # no reflections
        quaternions = [gtsam.Rot3(matrix).toQuaternion().coeffs() for matrix in axes]
        return self._rr.Ellipsoids3D(
            half_sizes=SIGMAS_SHOWN * np.sqrt(np.maximum(values, 0)),
            centers=centres @ rotation.T + pose.translation(),
            quaternions=np.reshape(quaternions, (-1, 4)),
            **looks,
        )

    def _show_truth(self, stamp: float, pose: gtsam.Pose3) -> None:
        """All of the ground truth, as soon as it says where the camera is."""
        here = None if self._truth is None else self._truth.interpolate(np.array([stamp]))
        if self._truth is None or not here:
            return
        world_T_truth = pose.compose(here.poses[0].inverse())
        positions = self._truth.positions @ world_T_truth.rotation().matrix().T + world_T_truth.translation()
        self._recording.log(TRUTH, self._rr.LineStrips3D([positions]), static=True)
        self._truth = None


def _rgb(colour: str) -> list[int]:
    """The bytes of #RRGGBB."""
    return list(bytes.fromhex(colour.removeprefix("#")))


def _level(status: Status) -> str:
    return "INFO" if status in (Status.TRACKED, Status.STATIC) else "WARN"


def _blueprint() -> rrb.Blueprint:
    """The scene beside the image, above curves and what happened; paths from their beginning on."""
    import rerun.blueprint as rrb

    past = [
        rrb.VisibleTimeRange(
            timeline, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
        )
        for timeline in (TIME, FRAME)
    ]
    scene = rrb.Spatial3DView(
        origin="world",
        name="scene",
        overrides={
            ONLINE: rrb.VisibleTimeRanges(past),
            POINT_ELLIPSOIDS: rrb.EntityBehavior(visible=False),
        },
    )
    curves = rrb.Horizontal(
        rrb.TimeSeriesView(origin=SCALE, name="scale (m per baseline)"),
        rrb.TimeSeriesView(origin=FEATURES, name="features"),
        rrb.TextLogView(origin=STATUS, name="status"),
    )
    picture = rrb.Spatial2DView(origin=IMAGE, name="image: tracks, landmarks by outcome")
    return rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(scene, picture, column_shares=[3, 2]), curves, row_shares=[3, 1]),
        rrb.TimePanel(timeline=TIME),
        collapse_panels=True,
    )
