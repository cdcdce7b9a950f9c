"""The poses of a run on their way to a file, and their covariances along fixed axes."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.runs.results import Run

DATED_SINCE = 1e8  # seconds; smaller stamps count from the beginning of a recording
STAMP_ROUNDING = 1e-6  # seconds, in files


@dataclass(frozen=True)
class ExportedPoses:
    """N poses of a run.

    Attributes:
        run: Which they are of.
        trajectory: world_T_camera; the world has the axes of the first camera: x right, y down, z forward.
        frames: (N,) indices of their frames.
        covariances: (N, 6, 6) in the tangents of the poses; None where they are not known.
        smoothed: Whether these are the poses by all measurements.
    """

    run: Run
    trajectory: Trajectory
    frames: NDArray[np.int64]
    covariances: NDArray[np.float64] | None
    smoothed: bool

    @classmethod
    def of(cls, run: Run, smoothed: bool) -> ExportedPoses:
        """The online or the smoothed poses of a run.

        Raises:
            ResultsError: The run has none.
        """
        trajectory = run.smoothed if smoothed else run.online
        if trajectory is None:
            raise ResultsError(f"{run.name} has no smoothed poses; those of mode graph that came to their end have")
        if not len(trajectory):
            raise ResultsError(f"{run.name} holds no poses to export")
        if not smoothed:
            return cls(run, trajectory, np.arange(len(trajectory)), run.pose_covariances, smoothed)
        # Poses that are not determined are left out of the smoothed ones.
        frames = np.searchsorted(run.online.stamps, trajectory.stamps - STAMP_ROUNDING)
        return cls(run, trajectory, frames, None, smoothed)

    @property
    def statuses(self) -> list[str]:
        """How each pose came about when its frame arrived."""
        statuses: list[str] = self.run.frames["status"][self.frames].tolist()
        return statuses

    @property
    def quaternions(self) -> NDArray[np.float64]:
        """(N, 4) rotations as x, y, z, w."""
        rotations = [pose.rotation().toQuaternion() for pose in self.trajectory.poses]
        return np.array([(q.x(), q.y(), q.z(), q.w()) for q in rotations])

    @property
    def nanoseconds(self) -> list[int]:
        """The stamps as whole numbers."""
        return [int(f"{stamp:.9f}".replace(".", "")) for stamp in self.trajectory.stamps]

    @property
    def times(self) -> list[str] | list[None]:
        """The stamps as dates and times (ISO 8601, UTC); None for each where they do not count from 1970."""
        if self.trajectory.stamps[0] < DATED_SINCE:
            return [None] * len(self.frames)
        return [datetime.fromtimestamp(stamp, UTC).isoformat() for stamp in self.trajectory.stamps]

    @property
    def fixed_axes_covariances(self) -> NDArray[np.float64] | None:
        """(N, 6, 6) of position (m), then rotation (rad), both along the axes of the world.

        A pose is off by exp(xi) on its right, xi being rotation, then translation, in the camera. Seen from the world,
        its position is off by R v and its rotation by the vector R w, to first order.
        """
        if self.covariances is None:
            return None
        jacobians = np.zeros((len(self.frames), 6, 6))
        jacobians[:, :3, 3:] = jacobians[:, 3:, :3] = self.trajectory.matrices[:, :3, :3]
        return jacobians @ self.covariances @ jacobians.swapaxes(1, 2)
