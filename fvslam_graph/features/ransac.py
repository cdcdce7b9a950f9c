"""Poses from matched points by RANSAC with local optimisation: PoseLib, or OpenCV's USAC where that is missing."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera

try:
    import poselib as poselib  # as an attribute, which measurements and tests take away
except ImportError:  # it has no wheel for ARM
    poselib = None

Array = NDArray[np.float64]

MIN_POINTS = 5  # that RANSAC can draw from
USAC_SEARCHES = 2
USAC_SUCCESS = 1 - 1e-9  # probability of a sample without outliers, which ends it; there is no least number


@dataclass(frozen=True)
class RansacOptions:
    """How RANSAC goes about it.

    Attributes:
        threshold: Pixels by which an inlier is off at most: its Sampson distance, or its reprojection error.
        loss_scale: Pixels beyond which a point counts for less in PoseLib's last refinement (Cauchy).
        seed: Of the samples.
        iterations: How many samples at least, which USAC does without, and at most.
        refinements: How many iterations PoseLib's last refinement has at most.
    """

    threshold: float
    loss_scale: float
    seed: int
    iterations: tuple[int, int] = (1000, 100_000)
    refinements: int = 100

    @property
    def poselib(self) -> dict[str, float]:
        """Options of PoseLib's RANSAC."""
        return {
            "max_epipolar_error": self.threshold,
            "max_reproj_error": self.threshold,
            "min_iterations": self.iterations[0],
            "max_iterations": self.iterations[1],
            "seed": self.seed,
        }

    @property
    def poselib_refinement(self) -> dict[str, float | str]:
        """Options of PoseLib's last refinement."""
        return {"loss_type": "CAUCHY", "loss_scale": self.loss_scale, "max_iterations": self.refinements}

    @property
    def usac(self) -> cv2.UsacParams:
        """Parameters of OpenCV's USAC: MSAC's score, samples drawn anew from inliers, least squares at the end."""
        options = cv2.UsacParams()
        options.threshold = self.threshold
        options.maxIterations = self.iterations[1]
        options.confidence = USAC_SUCCESS
        options.randomGeneratorState = self.seed
        options.loMethod = cv2.LOCAL_OPTIM_INNER_LO
        options.final_polisher = cv2.LSQ_POLISHER
        return options


def relative_poses(previous: Array, current: Array, camera: Camera, options: RansacOptions) -> list[gtsam.Pose3]:
    """What prev_T_cur may be, from N matched pixels (N, 2) of an undistorted camera, the baseline as unit.

    One by PoseLib. USAC falls more often for the second solution that points on a plane have: it searches twice.

    Source: Nister 2004 (five points); Larsson et al., PoseLib; Ivashechkin, Barath, Matas, "USACv20", 2021.
    """
    if len(previous) < MIN_POINTS:
        return []
    if poselib is not None:
        model = _poselib_camera(camera)
        found, _ = poselib.estimate_relative_pose(
            previous, current, model, model, options.poselib, options.poselib_refinement
        )
        return [gtsam.Pose3(gtsam.Rot3(found.R), found.t).inverse()]
    poses = []
    for again in range(USAC_SEARCHES):
        usac = replace(options, seed=options.seed ^ again).usac
        with suppress(cv2.error):  # as which OpenCV says that there is none
            E, inliers = cv2.findEssentialMat(previous, current, camera.K, camera.K, None, None, usac)
            if E is not None and E.shape == (3, 3):
                agree = inliers[:, 0] > 0
                poses.append(_decomposed(E, camera.normalize(previous[agree]), camera.normalize(current[agree])))
    return poses


def absolute_pose(
    points: Array, pixels: Array, camera: Camera, options: RansacOptions
) -> tuple[gtsam.Pose3, NDArray[np.bool_]] | None:
    """world_T_camera, and (N,) which points agree; None without one.

    Args:
        points: (N, 3) in the world, metres.
        pixels: (N, 2) where an undistorted camera sees them.
        camera: It.
        options: Of the RANSAC.

    Source: as of `relative_poses`, with three points.
    """
    if len(points) < MIN_POINTS:
        return None
    if poselib is not None:
        found, info = poselib.estimate_absolute_pose(
            pixels, points, _poselib_camera(camera), options.poselib, options.poselib_refinement
        )
        return gtsam.Pose3(gtsam.Rot3(found.R), found.t).inverse(), np.array(info["inliers"], bool)
    with suppress(cv2.error):
        good, _, rotation, t, rows = cv2.solvePnPRansac(points, pixels, camera.K, None, params=options.usac)
        if good and rows is not None:
            inliers = np.zeros(len(points), bool)
            inliers[rows[:, 0]] = True
            return gtsam.Pose3(gtsam.Rot3.Expmap(rotation[:, 0]), t[:, 0]).inverse(), inliers
    return None


def _decomposed(E: Array, previous: Array, current: Array) -> gtsam.Pose3:
    """prev_T_cur of an essential matrix, by its inliers (N, 2) at unit depth.

    Of both rotations, the smaller one: the other is half a turn about the baseline away. The sign of the direction is
    that in which points have moved on the whole: far ones, which noise lets move either way, hardly count.
    `cv2.recoverPose` counts them like all others, and took the wrong sign above a plane.
    """
    R1, R2, t = cv2.decomposeEssentialMat(E)
    R, t = max(R1, R2, key=np.trace), t[:, 0]
    turned = np.column_stack([previous, np.ones(len(previous))]) @ R.T
    turned = turned[:, :2] / turned[:, 2:]
    towards = t[:2] - turned * t[2]  # where points move to, the nearer the farther
    moved = float(((current - turned) * towards).sum())
    return gtsam.Pose3(gtsam.Rot3(R), np.copysign(1.0, moved) * t).inverse()


def _poselib_camera(camera: Camera) -> dict[str, object]:
    parameters = [camera.fx, camera.fy, camera.cx, camera.cy]
    return {"model": "PINHOLE", "width": camera.width, "height": camera.height, "params": parameters}
