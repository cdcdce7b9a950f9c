"""Absolute and relative pose errors as evo defines them, of all poses at once, in evo's own type of result.

evo goes pose by pose, which takes minutes for a million. Alignment, pairs and statistics are evo's own here; tests hold
every number against evo's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.association import TrajectoryPairs

if TYPE_CHECKING:
    from evo.core.metrics import PE
    from evo.core.result import Result
    from evo.core.trajectory import PoseTrajectory3D

Array = NDArray[np.float64]

BLOCK = 100_000  # motions at once: a million fit in memory, and all that is made of them does not
_TITLES = {
    Alignment.NONE: "(not aligned)",
    Alignment.ORIGIN: "(with origin alignment)",
    Alignment.SE3: "(with SE(3) Umeyama alignment)",
    Alignment.SIM3: "(with Sim(3) Umeyama alignment)",
}


@dataclass(frozen=True)
class Similarity:
    """Least squares from positions of an estimate to those of its reference (Umeyama).

    Attributes:
        rotation: (3, 3).
        scale: Factor on the estimate.
        centres: (3,) and (3,), means of estimate and reference, metres.
    """

    rotation: Array
    scale: float
    centres: tuple[Array, Array]

    @classmethod
    def between(cls, pairs: TrajectoryPairs) -> Similarity | None:
        """Fit all positions of the pairs; None where the motion does not determine it."""
        from evo.core.geometry import GeometryException, umeyama_alignment

        estimate, reference = pairs.estimate.positions.T, pairs.reference.positions.T
        try:
            rotation, _, scale = umeyama_alignment(estimate, reference, with_scale=True)
        except GeometryException:
            return None
        return cls(rotation, float(scale), (estimate.mean(axis=1), reference.mean(axis=1)))

    def matrix(self, scaled: bool) -> Array:
        """The transformation (4, 4) of Sim(3), scale times rotation and translation, or the best one of SE(3)."""
        scale = self.scale if scaled else 1.0
        matrix = np.eye(4)
        matrix[:3, :3] = scale * self.rotation
        matrix[:3, 3] = self.centres[1] - scale * (self.rotation @ self.centres[0])
        return matrix


def aligned(pairs: TrajectoryPairs, align: Alignment, fit: Similarity | None) -> tuple[Array, Array]:
    """The poses of the estimate in the world of the reference, (N, 4, 4), and the transformation (4, 4) that led there.

    Args:
        pairs: Estimate and reference.
        align: How.
        fit: Of these pairs; needed for SE3 and SIM3.
    """
    poses = pairs.estimate.matrices
    if align is Alignment.NONE:
        return poses, np.eye(4)
    if align is Alignment.ORIGIN:
        transformation = pairs.reference.matrices[0] @ np.linalg.inv(poses[0])
        return transformation @ poses, transformation
    assert fit is not None, "there is no such alignment"
    transformation = fit.matrix(scaled=align is Alignment.SIM3)
    moved = transformation @ poses
    moved[:, :3, :3] = fit.rotation @ poses[:, :3, :3]  # rotations are not scaled
    return moved, transformation


def motion_errors(
    estimate: Array, reference: Array, start: NDArray[np.int64], end: NDArray[np.int64], scale: float = 1.0
) -> tuple[Array, Array]:
    """How far the motions between some poses are apart.

    Args:
        estimate, reference: (N, 4, 4) poses, each in a world of its own.
        start, end: (M,) which poses the motions lead from, and to.
        scale: Factor on the translations of the estimate.

    Returns:
        (M,) distances, metres, and (M,) angles, degrees.
    """
    metres, angles = np.empty(len(start)), np.empty(len(start))
    for begin in range(0, len(start), BLOCK):
        block = slice(begin, begin + BLOCK)
        ours = _relative(estimate[start[block]], estimate[end[block]])
        ours[:, :3, 3] *= scale
        error = _relative(_relative(reference[start[block]], reference[end[block]]), ours)
        metres[block], angles[block] = np.linalg.norm(error[:, :3, 3], axis=1), degrees(error[:, :3, :3])
    return metres, angles


def degrees(rotations: Array) -> Array:
    """Angles (N,) of rotation matrices (N, 3, 3), degrees."""
    from scipy.spatial.transform import Rotation

    angles: Array = np.degrees(Rotation.from_matrix(rotations).magnitude())
    return angles


@dataclass(frozen=True)
class PoseErrors:
    """Errors of an estimate that was aligned.

    Attributes:
        pairs: Estimate and reference.
        align: How the estimate was aligned,
        poses: where that has led its poses, (N, 4, 4),
        transformation: and by what, (4, 4).
        name: Of the estimate, in evo's results.
    """

    pairs: TrajectoryPairs
    align: Alignment
    poses: Array
    transformation: Array
    name: str

    def results(self) -> dict[str, Result]:
        """The results by name: absolute errors, relative ones from pose to pose, and over one metre if there are any.

        Those of translations, `_trans`, are in metres, those of rotations, `_rot`, in degrees.
        """
        from evo.core.filters import filter_pairs_by_path
        from evo.core.metrics import APE, RPE, PoseRelation, Unit

        trans, rot = PoseRelation.translation_part, PoseRelation.rotation_angle_deg
        reference, every = self.pairs.reference.matrices, np.arange(len(self.poses))
        away = np.linalg.norm(self.poses[:, :3, 3] - reference[:, :3, 3], axis=1)
        turned = degrees(self.poses[:, :3, :3].swapaxes(1, 2) @ reference[:, :3, :3])
        absolute = {"ape_trans": (APE(trans), away), "ape_rot": (APE(rot), turned)}
        results = self._results(absolute, every)
        consecutive = np.stack([every[:-1], every[1:]], axis=1)
        metre = np.array(filter_pairs_by_path(reference, 1.0), dtype=int).reshape(-1, 2)
        for key, ids, unit in (("rpe", consecutive, Unit.frames), ("rpe_1m", metre, Unit.meters)):
            if not len(ids):
                continue
            start, end = ids.T
            metres, angles = motion_errors(self.poses, reference, start, end)
            errors = {
                f"{key}_trans": (RPE(trans, 1.0, unit, pairs_from_reference=True), metres),
                f"{key}_rot": (RPE(rot, 1.0, unit, pairs_from_reference=True), angles),
            }
            results |= self._results(errors, np.concatenate([[0], end]))
        return results

    def _results(self, errors: dict[str, tuple[PE, Array]], poses: NDArray[np.int64]) -> dict[str, Result]:
        """Errors as evo's results; `poses` are those that they belong to, with the first pose before relative ones."""
        reference = _evo(self.pairs.reference.stamps, self.pairs.reference.matrices, poses)
        estimate = _evo(self.pairs.estimate.stamps, self.poses, poses)
        results = {}
        for key, (metric, error) in errors.items():
            metric.error = error
            results[key] = result = metric.get_result("reference", self.name)
            result.info["title"] = f"{metric}\n{_TITLES[self.align]}"
            result.trajectories = {"reference": reference, self.name: estimate}
            known = slice(len(poses) - len(error), None)
            result.add_np_array("seconds_from_start", estimate.timestamps[known] - estimate.timestamps[0])
            result.add_np_array("timestamps", estimate.timestamps[known])
            result.add_np_array("distances_from_start", reference.distances[known])
            result.add_np_array("distances", estimate.distances[known])
            if self.align is not Alignment.NONE:
                result.add_np_array("alignment_transformation_sim3", self.transformation)
        return results


def _evo(stamps: Array, matrices: Array, rows: NDArray[np.int64]) -> PoseTrajectory3D:
    """Some poses as evo's own type; from arrays, since evo copies matrices one by one."""
    from evo.core.trajectory import PoseTrajectory3D
    from scipy.spatial.transform import Rotation

    quaternions = Rotation.from_matrix(matrices[rows, :3, :3]).as_quat(scalar_first=True)
    return PoseTrajectory3D(matrices[rows, :3, 3], quaternions, stamps[rows])


def _relative(a: Array, b: Array) -> Array:
    """Pose of b in a, (N, 4, 4), of rigid poses (N, 4, 4)."""
    result = np.tile(np.eye(4), (len(a), 1, 1))
    inverse = a[:, :3, :3].swapaxes(1, 2)
    result[:, :3, :3] = inverse @ b[:, :3, :3]
    result[:, :3, 3] = (inverse @ (b[:, :3, 3] - a[:, :3, 3])[:, :, None])[:, :, 0]
    return result
