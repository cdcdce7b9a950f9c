"""The metric pose that two views and a scale make."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.gaussian_pose import GaussianPose, LogScale
from fvslam_graph.vo.relative_pose import RelativePose


def metric_pose(relative_pose: RelativePose, scale: LogScale) -> GaussianPose:
    """The pose prev_T_cur of two views with a scale.

    Its covariance holds what two views tell, and the scale along the baseline.
    """
    jacobian = metric_jacobian(relative_pose, scale)
    measured = np.zeros((6, 6))
    measured[:5, :5] = relative_pose.covariance
    measured[5, 5] = scale.variance
    covariance: NDArray[np.float64] = jacobian @ measured @ jacobian.T
    prev_T_cur = gtsam.Pose3(relative_pose.rotation, scale.metres * relative_pose.direction)
    return GaussianPose(prev_T_cur, (covariance + covariance.T) / 2)


def metric_jacobian(relative_pose: RelativePose, scale: LogScale) -> NDArray[np.float64]:
    """How the pose changes with what two views tell, and with the logarithm of the scale, (6, 6)."""
    cur_R_prev = relative_pose.rotation.matrix().T
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = np.eye(3)
    jacobian[3:, 3:5] = scale.metres * cur_R_prev @ gtsam.Unit3(relative_pose.direction).basis()
    jacobian[3:, 5] = scale.metres * cur_R_prev @ relative_pose.direction
    return jacobian
