"""Stamped camera poses; `trajectory_files` knows the layouts of files that hold them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import TrajectoryError
from fvslam_graph.core.trajectory_files import Layout, read_rows

if TYPE_CHECKING:
    from evo.core.trajectory import PoseTrajectory3D


class Status(StrEnum):
    """How the pose of a frame came about."""

    TRACKED = "tracked"  # estimated from the image
    UNSCALED = "unscaled"  # likewise, but nothing tells how long the motion is: the scale was lost and is a guess
    STATIC = "static"  # the image did not move
    COASTED = "coasted"  # too little to see, or not to be believed: the motion model carried on
    SKIPPED = "skipped"  # no image could be read, or none that is new: the motion model carried on
    REINITIALISED = "reinitialised"  # tracking was lost and begins anew at this pose


@dataclass(frozen=True)
class Trajectory:
    """Poses over time.

    Attributes:
        stamps: (N,) seconds, strictly increasing.
        poses: N poses world_T_camera, metres.
        rows: How many rows its file has, where that has no stamps (KITTI): `stamps` then are numbers of rows, from 0.
        notes: What was left out or guessed when it was read, one sentence each.

    Raises:
        TrajectoryError: The lengths differ, a number is not finite, or stamps do not increase.
    """

    stamps: NDArray[np.float64]
    poses: tuple[gtsam.Pose3, ...]
    rows: int | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if len(self.stamps) != len(self.poses):
            raise TrajectoryError(f"{len(self.stamps)} stamps do not fit {len(self.poses)} poses")
        _require(np.isfinite(self.stamps), "has a stamp that is not a finite number")
        _require(np.isfinite(self.matrices).all(axis=(1, 2)), "has a pose with a number that is not finite")
        in_order = np.diff(self.stamps, prepend=-np.inf) > 0
        _require(
            in_order, "has a stamp that is not later than the one before", "sort the poses by time, each time once"
        )

    def __len__(self) -> int:
        return len(self.poses)

    def __repr__(self) -> str:
        if not self.poses:
            return "Trajectory(no poses)"
        return f"Trajectory({len(self)} poses in {np.ptp(self.stamps):.4g} s, {self.path_length:.4g} m)"

    @classmethod
    def from_matrices(cls, stamps: NDArray[np.float64], matrices: NDArray[np.float64]) -> Trajectory:
        """From homogeneous matrices (N, 4, 4); rotations, which text files round, are brought back onto SO(3)."""
        _require(np.isfinite(matrices).all(axis=(1, 2)), "has a pose with a number that is not finite")
        turns = np.clip(matrices[:, :3, :3], -2, 2)  # so that nothing overflows
        off = np.abs(turns @ turns.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
        _require((off < 0.01) & (np.linalg.det(turns) > 0), "has a pose without a proper rotation matrix")
        return cls(np.asarray(stamps, float), tuple(pose_from_matrix(matrix) for matrix in matrices))

    @cached_property
    def matrices(self) -> NDArray[np.float64]:
        """Homogeneous matrices, (N, 4, 4)."""
        matrices = np.empty((len(self.poses), 4, 4))
        for matrix, pose in zip(
            matrices, self.poses, strict=True
        ):  # a list of a million arrays is larger than all else
            matrix[:] = pose.matrix()
        return matrices

    @property
    def positions(self) -> NDArray[np.float64]:
        """Camera centres in the world, (N, 3), metres."""
        return self.matrices[:, :3, 3]

    @property
    def path_length(self) -> float:
        """Length of the path through all positions, metres."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    def between(self, start: float, end: float) -> Trajectory:
        """The part with start <= stamp <= end, seconds."""
        inside = np.flatnonzero((self.stamps >= start) & (self.stamps <= end))
        return replace(self, stamps=self.stamps[inside], poses=tuple(self.poses[i] for i in inside))

    def from_origin(self) -> Trajectory:
        """The same motion, expressed in the first camera frame."""
        if not self.poses:
            return self
        return replace(self, poses=tuple(self.poses[0].between(pose) for pose in self.poses))

    def interpolate(self, stamps: NDArray[np.float64], max_gap: float = 0.5) -> Trajectory:
        """Poses at other times, on the geodesic between neighbours.

        Times outside the trajectory, or in a gap of more than `max_gap` seconds, are left out.
        """
        kept: list[float] = []
        poses: list[gtsam.Pose3] = []
        for stamp in stamps:
            after = int(np.searchsorted(self.stamps, stamp))
            if after < len(self) and self.stamps[after] == stamp:
                pose = self.poses[after]
            elif 0 < after < len(self) and (gap := self.stamps[after] - self.stamps[after - 1]) <= max_gap:
                fraction = (stamp - self.stamps[after - 1]) / gap
                pose = interpolate(self.poses[after - 1], self.poses[after], fraction)
            else:
                continue
            kept.append(float(stamp))
            poses.append(pose)
        return Trajectory(np.array(kept), tuple(poses))

    def write_tum(self, path: Path) -> None:
        """Write `stamp tx ty tz qx qy qz qw` lines (TUM RGB-D benchmark)."""
        path.write_text("".join(tum_line(s, p) for s, p in zip(self.stamps, self.poses, strict=True)))

    def write_kitti(self, path: Path) -> None:
        """Write the rows of the 3x4 matrices, one pose a line (KITTI odometry benchmark)."""
        path.write_text("".join(kitti_line(pose) for pose in self.poses))

    @classmethod
    def read(cls, path: Path, unfinished: bool = False, layout: Layout | None = None) -> Trajectory:
        """Read a file of TUM's, KITTI's or the ASL layout, as `read_rows` recognises it.

        Args:
            path: Of the file.
            unfinished: Leave out a last line without its line end: its writer was stopped in the middle.
            layout: Where it is known.

        Raises:
            TrajectoryError: Names the file, and what is wrong with it.
        """
        rows = read_rows(path, unfinished, layout)
        try:
            if rows.stamps is None:
                matrices = np.hstack([rows.poses, np.tile([0.0, 0.0, 0.0, 1.0], (len(rows.poses), 1))])
                numbered = cls.from_matrices(rows.numbers.astype(float), matrices.reshape(-1, 4, 4))
                return replace(numbered, rows=rows.count, notes=rows.notes)
            quaternions = np.clip(rows.poses[:, 3:], -2, 2)
            norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
            _require(np.abs(norms - 1) < 0.01, "has a quaternion whose length is not 1")
            poses = tuple(
                gtsam.Pose3(gtsam.Rot3.Quaternion(qw, qx, qy, qz), np.array(position))
                for position, (qx, qy, qz, qw) in zip(rows.poses[:, :3], quaternions / norms, strict=True)
            )
            return cls(rows.stamps, poses, notes=rows.notes)
        except TrajectoryError as error:
            raise TrajectoryError(f"{path}: {error}") from None

    @classmethod
    def read_tum(cls, path: Path, unfinished: bool = False) -> Trajectory:
        """Read a file with stamps (TUM, ASL); arguments and errors are those of `read`."""
        trajectory = cls.read(path, unfinished)
        if trajectory.rows is not None:
            raise TrajectoryError(f"{path} has no stamps: a pose has 12 numbers, as in KITTI's files, not 8")
        return trajectory

    @classmethod
    def read_kitti(cls, path: Path, stamps: NDArray[np.float64] | None = None) -> Trajectory:
        """Read a KITTI file; without `stamps`, (N,) seconds of its rows, these are numbered 0, 1, 2, ..."""
        trajectory = cls.read(path)
        if trajectory.rows is None:
            raise TrajectoryError(f"{path} is no KITTI file: a pose has stamp and quaternion, not 12 numbers")
        if stamps is None:
            return trajectory
        if len(stamps) != trajectory.rows:
            raise TrajectoryError(f"{path} has {trajectory.rows} poses, but the sequence has {len(stamps)} frames")
        return replace(trajectory, stamps=stamps[trajectory.stamps.astype(int)], rows=None)

    def to_evo(self) -> PoseTrajectory3D:
        """The same as evo's own type."""
        from evo.core.trajectory import PoseTrajectory3D

        return PoseTrajectory3D(poses_se3=list(self.matrices), timestamps=self.stamps)


def pose_from_matrix(matrix: NDArray[np.float64]) -> gtsam.Pose3:
    """The pose of a 4x4 or 3x4 matrix whose rotation may be rounded (text files)."""
    rotation = gtsam.Rot3.ClosestTo(np.ascontiguousarray(matrix[:3, :3]))
    return gtsam.Pose3(rotation, np.array(matrix[:3, 3]))


def interpolate(a: gtsam.Pose3, b: gtsam.Pose3, fraction: float) -> gtsam.Pose3:
    """Between two poses: position on the straight line, rotation on the geodesic; fraction 0 gives a, 1 gives b."""
    rotation = a.rotation().slerp(fraction, b.rotation())
    return gtsam.Pose3(rotation, (1 - fraction) * a.translation() + fraction * b.translation())


def tum_line(stamp: float, pose: gtsam.Pose3) -> str:
    """One line of a TUM file, with all digits of the pose."""
    x, y, z = pose.translation()
    q = pose.rotation().toQuaternion()
    return f"{stamp:.9f} {x:.17g} {y:.17g} {z:.17g} {q.x():.17g} {q.y():.17g} {q.z():.17g} {q.w():.17g}\n"


def kitti_line(pose: gtsam.Pose3) -> str:
    """One line of a KITTI pose file, with all digits of the pose."""
    return " ".join(f"{number:.17g}" for number in pose.matrix()[:3].ravel()) + "\n"


def _require(good: Any, complaint: str, advice: str = "") -> None:
    if not np.all(good):
        where = f"at pose {int(np.argmin(good)) + 1} of {len(good)}"
        raise TrajectoryError(f"the trajectory {complaint}, {where}" + (f"; {advice}" if advice else ""))
