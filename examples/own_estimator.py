"""Compare an estimator of your own with ours: over seeds, with times, NEES and what is significant."""

import sys
from pathlib import Path

import cv2
import gtsam
import numpy as np

import fvslam_graph
from fvslam_graph.core.frame_result import FrameResult
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.trajectory import Status


def optical_mouse(sequence, seed):
    """Odometry of a downward camera that never turns, from the shift of the image; yields a result for each frame."""
    pose, last = GaussianPose.identity(), None
    for frame in sequence:
        image = cv2.GaussianBlur(frame.image, (5, 5), 1).astype(np.float32)
        motion = GaussianPose.identity()
        if last is not None:
            (u, v), _ = cv2.phaseCorrelate(last, image, cv2.createHanningWindow(image.shape[::-1], cv2.CV_32F))
            metres = frame.height / sequence.camera.fx
            shift = gtsam.Pose3(gtsam.Rot3(), -metres * np.array([u, v, 0.0]))
            motion = GaussianPose(shift, np.diag([0.02, 0.02, 0.02, 10 * metres, 10 * metres, 0.2]) ** 2)
            pose = pose.compose(motion)
        status = Status.STATIC if last is None else Status.TRACKED
        yield FrameResult(frame.index, frame.stamp, pose, status, max(frame.index - 1, 0), motion)
        last = image


if __name__ == "__main__":
    sequence, out = sys.argv[1:] or ["synthetic:uav?frames=40", "runs/own_estimator"]
    results = fvslam_graph.compare(sequence, ["vo", optical_mouse], seeds=2, out=Path(out))
    print(results.summary().markdown())
    medians = results.finished.groupby("mode")["ape"].median()
    print(f"optical_mouse {medians['optical_mouse']:.2f} m, vo {medians['vo']:.2f} m")
