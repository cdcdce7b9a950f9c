"""Fuse odometry and visual SLAM by a rule of your own, see whether its covariance is right, and compare it.

A rule in a module of its own is compared from the command line, too: `fvslam compare PATH --modes vo,mypkg:HalfWay`.
"""

import sys
from pathlib import Path

import gtsam

import fvslam_graph
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.testing import assert_rule_is_consistent


class HalfWay:
    """Rotation by odometry, position half way between the two; the covariance is the mean, whatever they share."""

    def __call__(self, odometry: GaussianPose, slam: GaussianPose) -> GaussianPose:
        """Fuse two estimates of one motion."""
        middle = (odometry.mean.translation() + slam.mean.translation()) / 2
        pose = gtsam.Pose3(odometry.mean.rotation(), middle)
        return GaussianPose(pose, (odometry.covariance + slam.covariance) / 2)


if __name__ == "__main__":
    sequence, out = sys.argv[1:] or ["synthetic:uav?frames=40", "runs/own_rule"]
    found = assert_rule_is_consistent(HalfWay(), seeds=2)
    print(f"NEES {found.mean:.1f}, 6 is consistent")
    modes = ["vo", "average", f"{__name__}:HalfWay"]
    results = fvslam_graph.compare(sequence, modes, seeds=1, out=Path(out))
    for mode, error in zip(results.table["mode"], results.table["ape"], strict=True):
        print(f"{mode}: {error:.3f} m")
