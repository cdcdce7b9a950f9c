import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera
from fvslam_graph.features import ransac
from fvslam_graph.features.ransac import RansacOptions, absolute_pose, relative_poses

CAMERA = Camera(640, 480, 500.0, 510.0, 320.0, 240.0)
prev_T_cur = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.01, 0.02, -0.01), np.array([0.3, 0.1, 0.5]))
OPTIONS = RansacOptions(threshold=1.0, loss_scale=0.4, seed=3, iterations=(25, 500))


@pytest.fixture(params=["poselib", "usac"])
def library(request, monkeypatch):
    if request.param == "usac":
        monkeypatch.setattr(ransac, "poselib", None)
    elif ransac.poselib is None:
        pytest.skip("PoseLib is not installed")
    return request.param


def scene(outliers: int = 24):
    """120 points and where both cameras see them, with 0.1 pixels of noise; the first ones are wrong in the second."""
    rng = np.random.default_rng(5)
    depth = rng.uniform(4, 20, 120)
    points = np.column_stack([rng.uniform(-0.6, 0.6, 120) * depth, rng.uniform(-0.45, 0.45, 120) * depth, depth])
    seen = (points - prev_T_cur.translation()) @ prev_T_cur.rotation().matrix()
    previous, current = (CAMERA.project(at) + rng.normal(0, 0.1, (120, 2)) for at in (points, seen))
    current[:outliers] += rng.choice([-1, 1], (outliers, 2)) * rng.uniform(15, 60, (outliers, 2))
    return points, previous, current


def test_a_relative_pose_among_outliers(library):
    _, previous, current = scene()
    found = relative_poses(previous, current, CAMERA, OPTIONS)[0]
    direction = prev_T_cur.translation() / np.linalg.norm(prev_T_cur.translation())
    assert np.linalg.norm(gtsam.Rot3.Logmap(found.rotation().between(prev_T_cur.rotation()))) < 0.004  # rad
    assert np.linalg.norm(found.translation() - direction) < 0.02


def test_an_absolute_pose_among_outliers(library):
    points, _, current = scene()
    pose, inliers = absolute_pose(points, current, CAMERA, OPTIONS)
    assert pose.equals(prev_T_cur, 0.01)
    assert inliers.sum() == 96 and not inliers[:24].any()


def test_the_same_seed_the_same_bits(library):
    points, previous, current = scene()
    first, again = (
        (relative_poses(previous, current, CAMERA, OPTIONS)[0], absolute_pose(points, current, CAMERA, OPTIONS)[0])
        for _ in range(2)
    )
    assert [pose.matrix().tolist() for pose in first] == [pose.matrix().tolist() for pose in again]


@pytest.mark.parametrize("count", [0, 4])
def test_too_few_points(library, count):
    points, previous, current = scene()
    assert relative_poses(previous[:count], current[:count], CAMERA, OPTIONS) == []
    assert absolute_pose(points[:count], current[:count], CAMERA, OPTIONS) is None


def test_points_that_are_all_one_have_no_pose_that_is_believed(library):
    nowhere = np.zeros((20, 2))
    relative_poses(nowhere, nowhere, CAMERA, OPTIONS)  # whatever comes: it is refined and judged by all tracks
    found = absolute_pose(np.ones((20, 3)), scene()[2][:20], CAMERA, OPTIONS)
    assert found is None or found[1].sum() < 10
