"""Radial distortion that a calibration has left in the images, by how odometry's tracks fit together."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import EstimationError
from fvslam_graph.core.sequence import MAX_RESIDUAL_K1, Sequence
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.vo.epipolar import MatchedRays, calibration_jacobian, epipolar_distance
from fvslam_graph.vo.odometry import VisualOdometry

Array = NDArray[np.float64]

LOSS_SCALE = 0.4  # pixels beyond which a point counts for less
PASSES = 3


class RadialDistortion:
    """One coefficient for all images, from many pairs of them.

    It is that of `calibration_jacobian`, and shows in the epipolar distances of two views, mostly where the camera
    turns. The Cauchy loss is minimised by one step of Newton from zero, with the motion of each pair, which would take
    up a part of it, eliminated.

    Args:
        camera: Of the images, without distortion as far as is known.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._pairs: list[tuple[float, float]] = []  # curvature of the Cauchy loss along k1, and its fall

    def add(self, tracks: Tracks, keyframe_T_cur: gtsam.Pose3) -> None:
        """Take in a pair of images.

        Args:
            tracks: N points in both.
            keyframe_T_cur: The motion that explains them best without distortion; its length does not matter.
        """
        matched = replace(MatchedRays.of(self._camera, tracks), covariances=None)
        rotation, direction = (
            keyframe_T_cur.rotation(),
            keyframe_T_cur.translation() / np.linalg.norm(keyframe_T_cur.translation()),
        )
        distance, J_motion = epipolar_distance(matched, rotation, direction)
        J_k1 = calibration_jacobian(matched, rotation, direction)[:, 1]
        square = (distance / LOSS_SCALE) ** 2
        curvature = (1 - square) / (1 + square) ** 2
        weighted = curvature[:, None] * J_motion
        own = J_k1 - J_motion @ np.linalg.solve(weighted.T @ J_motion, weighted.T @ J_k1)
        self._pairs.append((float(own @ (curvature * own)), -float(own @ (distance / (1 + square)))))

    def estimate(self) -> tuple[float, float]:
        """k1 and its standard deviation, by how much the pairs differ about it.

        Raises:
            EstimationError: There are fewer than two pairs.
        """
        if len(self._pairs) < 2:
            raise EstimationError("the camera has not moved enough to tell its distortion")
        curvature, fall = np.array(self._pairs).T
        k1 = fall.sum() / curvature.sum()
        return float(k1), float(np.linalg.norm(fall - curvature * k1) / curvature.sum())


def measure_distortion(sequence: Sequence) -> tuple[float, float]:
    """k1 of a recording and its standard deviation, by odometry on all of its frames.

    A strong distortion makes outliers of the points that tell most about it; so it is taken out, and what is left
    is measured again.

    Raises:
        EstimationError: The camera has hardly moved.
    """
    k1 = 0.0
    for _ in range(PASSES):
        vo = VisualOdometry(sequence.camera, load_config(settings=["scale.source=unit"]))
        distortion = RadialDistortion(sequence.camera)
        for frame in sequence.undistorted(k1) if k1 else sequence:
            estimate = vo.step(frame)
            if estimate.scale is not None:  # by two views
                distortion.add(estimate.tracks, estimate.prev_T_cur.mean)
        more, sigma = distortion.estimate()
        k1 = min(max(k1 + more, -MAX_RESIDUAL_K1), MAX_RESIDUAL_K1)
    return k1, sigma
