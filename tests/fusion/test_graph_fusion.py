"""P_f by the graph, and where odometry has gone since."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.sequence import Frame
from fvslam_graph.core.slam_estimate import LandmarkObservations
from fvslam_graph.core.vo_estimate import OdometryStep
from fvslam_graph.fusion.graph_fusion import GraphFusion
from fvslam_graph.graph.factors import position_factor

CAMERA = Camera(640, 480, 450.0, 450.0, 319.5, 239.5)
NOTHING = LandmarkObservations(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 3)), np.empty((0, 3, 3)))


def motion(metres: float, seed: int) -> GaussianPose:
    mixing = 0.01 * np.random.default_rng(seed).standard_normal((6, 6))
    mean = gtsam.Pose3(gtsam.Rot3.Rodrigues(0.0, 0.02 * metres, 0.0), np.array([0.1, 0.0, metres]))
    return GaussianPose(mean, mixing @ mixing.T + 1e-6 * np.eye(6))


def flown(settings: GraphSettings) -> GraphFusion:
    """Frames 1 to 3 against frame 0, which is then replaced by frame 3."""
    fusion = GraphFusion(CAMERA, settings, None)
    for index, (previous, metres) in enumerate([(0, 0.0), (0, 1.0), (0, 2.0), (0, 3.0), (3, 1.0)]):
        taken = motion(metres, index) if index else GaussianPose.identity()
        fusion.add_odometry(Frame(index, 0.1 * index, None), OdometryStep(previous, taken, None, 0.0))
        if index == 1:
            fusion.start(fusion.pose, NOTHING)
        if index == 2:
            fusion.fuse(GaussianPose.identity(), GaussianPose.identity(), None)
    return fusion


@pytest.mark.parametrize("last", [3, 4])
def test_odometry_carries_on_as_the_graph_will_have_it(last):
    """From P_f at frame 2, by motions that start at frames 0 and 3: with no landmarks, nothing new is learnt of them.

    In particular, the motion to frame 2 is not counted for those that do not depend on it.
    """
    fusion = flown(GraphSettings(kernel="none", shared_pixels="ignore", online="latest"))
    before = fusion.pose
    fusion.fuse(GaussianPose.identity(), GaussianPose.identity(), None)
    assert before.mean.equals(fusion.pose.mean, 1e-9)
    assert before.covariance == pytest.approx(fusion.pose.covariance, rel=1e-3, abs=1e-8)
    assert fusion.reference.mean.equals(fusion.pose.mean, 1e-12)


def test_corrections_are_taken_up_over_an_interval():
    """A position that satellites tell moves P_f at once, and the online poses by a share of what is left a frame."""
    fusion, metres = GraphFusion(CAMERA, GraphSettings(), None), 1.0
    left = []
    for index in range(14):
        taken = motion(metres, index) if index else GaussianPose.identity()
        fusion.add_odometry(Frame(index, 0.1 * index, None), OdometryStep(max(index - 1, 0), taken, None, 0.0))
        if index == 1:
            fusion.start(fusion.pose, NOTHING)
        if index == 6:
            before = fusion.pose.mean.translation()
            fusion.graph.add(position_factor(6, before + np.array([0.5, 0.0, 0.0]), 1e-4))
            fusion.fuse(GaussianPose.identity(), GaussianPose.identity(), None)
            step = before - fusion.reference.mean.translation()
        if index >= 6:
            carried_on = fusion.reference.compose(fusion.motion.pose).mean.translation()
            left.append(np.linalg.norm(fusion.pose.mean.translation() - carried_on))
    assert np.linalg.norm(step) > 0.1
    assert left == pytest.approx(np.linalg.norm(step) * np.exp(-np.arange(1, 9) / 5), rel=1e-6)
    assert np.linalg.eigvalsh(fusion.pose.covariance - fusion._poses[13].covariance)[-1] == pytest.approx(left[-1] ** 2)


def test_odometry_that_starts_beyond_the_lag():
    """The motion since P_f is known nevertheless."""
    fusion = GraphFusion(CAMERA, GraphSettings(lag=0.45), None)
    for index in range(13):
        taken = motion(0.1 * index, index) if index else GaussianPose.identity()
        fusion.add_odometry(Frame(index, 0.1 * index, None), OdometryStep(0, taken, None, 0.0))
        if index == 1:
            fusion.start(fusion.pose, NOTHING)
        elif index % 5 == 0 and index:
            fusion.fuse(GaussianPose.identity(), GaussianPose.identity(), None)
    assert not fusion.graph.has(0)
    assert fusion.pose.mean.translation()[2] == pytest.approx(1.2, abs=0.2)
    assert np.linalg.eigvalsh(fusion.pose.covariance)[0] > 0
