"""What a fusion rule is."""

from __future__ import annotations

from typing import Protocol

from fvslam_graph.core.gaussian_pose import GaussianPose


class FusionRule(Protocol):
    """Makes one estimate of the motion since the last reference P_f out of two, whose correlation is not known.

    Both subsystems start at P_f, so that fusing their motions is fusing their poses, without the uncertainty that P_f
    brings into both.
    """

    def __call__(self, odometry: GaussianPose, slam: GaussianPose) -> GaussianPose:
        """The fused motion, from that of visual odometry (O_f) and that of visual SLAM (S_f)."""
