"""Landmarks that wait until they are known well enough for the graph."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.gates import chi2_gate
from fvslam_graph.core.slam_estimate import LandmarkObservations
from fvslam_graph.graph.factors import pose_key

Array = NDArray[np.float64]

MIN_DEPTH = 0.05  # metres in front of the camera
MAX_UNSEEN_FRAMES = 30  # frames after which a landmark that was not seen again is given up
TRIANGULATION_GATE = chi2_gate(0.99, 2)
UNIT_CALIBRATION = gtsam.Cal3_S2()  # of normalised coordinates
RANK_TOLERANCE = 1e-9  # of the triangulation


@dataclass(frozen=True)
class LandmarkObservation:
    """A landmark in one frame: its pixel (2,), and its point (3,) in the camera with covariance (3, 3), metres."""

    frame: int
    pixel: Array
    point: Array
    covariance: Array

    @classmethod
    def of(cls, observations: LandmarkObservations, row: np.intp, frame: int) -> LandmarkObservation:
        """One of the landmarks that a frame shows."""
        return cls(frame, observations.pixels[row], observations.points[row], observations.covariances[row])


@dataclass
class LandmarkCandidate:
    """A landmark with its views so far, and where these meet in the world, (3,)."""

    landmark: int
    observations: list[LandmarkObservation] = field(default_factory=list)
    position: Array = field(default_factory=lambda: np.full(3, np.nan))
    parallax: float = 0.0  # pixels, between the first and the last view


class LandmarkCandidates:
    """Collects views of landmarks, and says which are ready.

    A landmark is ready when it has enough views, from places far enough apart, that meet in a point in front of all of
    them. Those that the views tell most about come first.

    Args:
        settings: How many views and how much parallax are needed.
    """

    def __init__(self, settings: GraphSettings) -> None:
        self._settings = settings
        self._waiting: dict[int, LandmarkCandidate] = {}

    def ready(
        self,
        observations: LandmarkObservations,
        known: NDArray[np.bool_],
        poses: list[gtsam.Pose3],
        drift_variances: list[Array],
        has: Callable[[int], bool],
        camera: Camera,
    ) -> list[LandmarkCandidate]:
        """Take in the views of one frame, and hand out landmarks that can enter the graph.

        Args:
            observations: Of N landmarks, in the newest frame.
            known: (N,) which of them are in the graph already.
            poses: world_T_camera of all frames.
            drift_variances: (2, 2) of all frames: variance (rad^2, m^2, along an axis) of odometry's drift until there,
                and until the frame that its motion starts from.
            has: Whether the graph has a variable.
            camera: As it is known now.
        """
        ready, frame = [], len(poses) - 1
        for n in np.flatnonzero(~known):
            landmark = int(observations.ids[n])
            candidate = self._waiting.setdefault(landmark, LandmarkCandidate(landmark))
            candidate.observations.append(LandmarkObservation.of(observations, n, frame))
            if len(candidate.observations) >= self._settings.min_views and self._meets(
                candidate, poses, drift_variances, camera
            ):
                ready.append(candidate)
        ready.sort(key=lambda candidate: (len(candidate.observations), candidate.parallax), reverse=True)
        ready = ready[: self._settings.max_new]
        for candidate in ready:
            del self._waiting[candidate.landmark]
            candidate.observations = [
                view for view in candidate.observations if view.frame == frame or has(pose_key(view.frame))
            ]
        self._waiting = {
            landmark: candidate
            for landmark, candidate in self._waiting.items()
            if candidate.observations[-1].frame > frame - MAX_UNSEEN_FRAMES
        }
        return [candidate for candidate in ready if len(candidate.observations) >= self._settings.min_views]

    def _meets(
        self, candidate: LandmarkCandidate, poses: list[gtsam.Pose3], drift_variances: list[Array], camera: Camera
    ) -> bool:
        """Triangulate; whether the views agree, up to how well odometry knows the poses to each other."""
        seen_from = [poses[view.frame] for view in candidate.observations]
        pixels = np.array([view.pixel for view in candidate.observations])
        last = seen_from[-1].rotation().matrix() @ candidate.observations[-1].point
        first = last + seen_from[-1].translation() - seen_from[0].translation()
        angle = np.arctan2(np.linalg.norm(np.cross(first, last)), first @ last)
        candidate.parallax = float(angle * camera.fx)
        if not candidate.parallax > self._settings.min_parallax:  # nor where visual SLAM has dropped it: NaN
            return False
        try:
            point = gtsam.triangulatePoint3(
                seen_from, UNIT_CALIBRATION, list(camera.normalize(pixels)), RANK_TOLERANCE, False
            )
        except RuntimeError:  # behind a camera, or at infinity
            return False
        candidate.position = point
        there = np.array([pose.transformTo(point) for pose in seen_from])
        error = camera.project(there) - pixels
        begin, end = drift_variances[candidate.observations[0].frame], drift_variances[candidate.observations[-1].frame]
        turned, moved = end[0] + begin[0] - 2 * begin[1]  # both are known from where the first one's motion starts
        variance = self._settings.pixel_sigma**2 + camera.fx**2 * (turned + moved / there[:, 2] ** 2)
        return bool((there[:, 2] > MIN_DEPTH).all() and ((error**2).sum(axis=1) < TRIANGULATION_GATE * variance).all())
