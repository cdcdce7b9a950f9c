"""Test an estimator of your own against worlds whose ground truth is exact: `pytest examples/test_my_estimator.py`."""

import cv2
import gtsam
import numpy as np

from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.testing import assert_ape_below, rendered


def optical_mouse(sequence):
    """Odometry of a downward camera that never turns: the shift of the image, times height over focal length."""
    pose, poses, previous = gtsam.Pose3(), [], None
    for frame in sequence:
        image = frame.image.astype(np.float32)
        if previous is not None:
            (u, v), _ = cv2.phaseCorrelate(previous, image, cv2.createHanningWindow(image.shape[::-1], cv2.CV_32F))
            shift = -frame.height / sequence.camera.fx * np.array([u, v, 0.0])
            pose = pose * gtsam.Pose3(gtsam.Rot3(), shift)
        poses.append(pose)
        previous = image
    return Trajectory(sequence.stamps, tuple(poses))


def test_it_is_right_within_a_tenth_of_the_path():
    flight = rendered("uav", frames=20, size="320x240", seed=2)
    truth = flight.ground_truth
    evaluation = assert_ape_below(optical_mouse(flight), 0.1 * truth.path_length, truth)
    print(f"APE {evaluation.errors['ape_trans'].stats['rmse']:.2f} m on {truth.path_length:.0f} m")
