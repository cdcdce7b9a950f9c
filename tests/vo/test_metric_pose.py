"""What two views and a scale make of a pose and of its covariance."""

import math

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.gaussian_pose import LogScale
from fvslam_graph.vo.metric_pose import metric_pose
from fvslam_graph.vo.relative_pose import RelativePose

ROTATION = gtsam.Rot3.Expmap(np.array([0.3, -0.2, 0.5]))
DIRECTION = gtsam.Unit3(np.array([0.3, -0.5, 0.8]))
SCALE = LogScale(math.log(2.5), 0.04)


def test_covariance_by_finite_differences():
    mixing = 0.1 * np.random.default_rng(0).standard_normal((5, 5))
    relative_pose = RelativePose(
        ROTATION, DIRECTION.point3(), mixing @ mixing.T, np.ones(1, bool), np.zeros((1, 2)), 0.3, np.zeros((5, 2))
    )
    metric = metric_pose(relative_pose, SCALE)
    pose, covariance = metric.mean, metric.covariance
    assert pose.equals(gtsam.Pose3(ROTATION, 2.5 * DIRECTION.point3()), 1e-12)

    def change(step: np.ndarray) -> np.ndarray:
        moved = gtsam.EssentialMatrix(ROTATION, DIRECTION).retract(step[:5])
        metres = math.exp(SCALE.mean + step[5])
        return gtsam.Pose3.Logmap(pose.between(gtsam.Pose3(moved.rotation(), metres * moved.direction().point3())))

    step = 1e-6
    jacobian = np.column_stack([(change(step * e) - change(-step * e)) / (2 * step) for e in np.eye(6)])
    measured = np.zeros((6, 6))
    measured[:5, :5], measured[5, 5] = relative_pose.covariance, SCALE.variance
    assert covariance == pytest.approx(jacobian @ measured @ jacobian.T, rel=1e-6, abs=1e-8)
    assert np.array_equal(covariance, covariance.T)


def test_an_unknown_scale_is_uncertain_along_the_baseline_alone():
    relative_pose = RelativePose(
        ROTATION, DIRECTION.point3(), np.zeros((5, 5)), np.ones(1, bool), np.zeros((1, 2)), 0.3, np.zeros((5, 2))
    )
    covariance = metric_pose(relative_pose, LogScale(0.0, 1.0)).covariance
    along = np.concatenate([np.zeros(3), ROTATION.unrotate(DIRECTION.point3())])
    assert covariance == pytest.approx(np.outer(along, along), abs=1e-12)
