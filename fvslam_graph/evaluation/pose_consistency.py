"""Errors of poses beside the covariances that the estimator claims for them."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.evaluation.association import TrajectoryPairs
from fvslam_graph.evaluation.nees import nees


@dataclass(frozen=True)
class PoseConsistency:
    """Errors of K poses since the first one, whose frame is the world: no alignment makes them smaller.

    Attributes:
        frames: (K,) which poses of the estimate these are.
        positions: (K, 3) estimate minus reference, metres.
        covariances: (K, 3, 3) of the estimated positions.
        nees: (K,) of the whole poses.
        dof: (K,) degrees of freedom, the expected NEES.
    """

    frames: NDArray[np.int64]
    positions: NDArray[np.float64]
    covariances: NDArray[np.float64]
    nees: NDArray[np.float64]
    dof: NDArray[np.int64]


def pose_consistency(
    pairs: TrajectoryPairs, covariances: NDArray[np.float64] | None, scale: float = 1.0
) -> PoseConsistency | None:
    """Compare poses with their covariances.

    Args:
        pairs: Estimate and reference. The first pair is taken to be exact, as the first pose of a run is.
        covariances: (N, 6, 6) of all poses of the estimate, in the tangent of each.
        scale: Factor on lengths of the estimate (Sim3 alignment).

    Returns:
        None where no pose has a covariance other than zero.
    """
    if covariances is None:
        return None
    claimed = covariances[pairs.indices]
    known = np.flatnonzero(np.isfinite(claimed).all(axis=(1, 2)) & claimed.any(axis=(1, 2)))
    if not len(known):
        return None
    metric = np.repeat([1.0, scale], 3)
    claimed = claimed[known] * np.outer(metric, metric)
    errors, positions, rotations = np.empty((len(known), 6)), np.empty((len(known), 3)), np.empty((len(known), 3, 3))
    estimates, references = pairs.estimate.poses, pairs.reference.poses
    for row, number in enumerate(known):
        moved = estimates[0].between(estimates[number])
        estimate = gtsam.Pose3(moved.rotation(), scale * moved.translation())
        reference = references[0].between(references[number])
        errors[row] = gtsam.Pose3.Logmap(estimate.between(reference))
        positions[row] = estimate.translation() - reference.translation()
        rotations[row] = estimate.rotation().matrix()
    of_positions = rotations @ claimed[:, 3:, 3:] @ rotations.swapaxes(1, 2)
    return PoseConsistency(pairs.indices[known], positions, of_positions, *nees(errors, claimed))
