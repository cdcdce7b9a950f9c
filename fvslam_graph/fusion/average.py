"""The paper's fusion: the weighted mean of both estimates (section 3)."""

from __future__ import annotations

from dataclasses import dataclass

from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.trajectory import interpolate


@dataclass(frozen=True)
class Average:
    """Position by the arithmetic mean, rotation on the geodesic; or both on the geodesic of SE(3).

    The mean of the components is the maximum a posteriori of a graph with rotation and translation priors of
    information 1 - w and w. The geodesic of SE(3) is not quite that of two priors of six degrees of freedom: rotation
    and translation are coupled, and the two differ in the second order of their distance.

    Attributes:
        weight: Of visual SLAM, from 0 to 1.
        geodesic: Whether the mean is that of SE(3).
    """

    weight: float
    geodesic: bool = False

    def __call__(self, odometry: GaussianPose, slam: GaussianPose) -> GaussianPose:
        """The mean; its covariance is the largest that the unknown correlation of the two allows.

        Whatever two errors have in common, the variance of their weighted mean is at most that of the mean of their
        variances (Jensen's inequality).
        """
        if self.geodesic:
            mean = odometry.mean.slerp(self.weight, slam.mean)
        else:
            mean = interpolate(odometry.mean, slam.mean, self.weight)
        covariance = (1 - self.weight) * odometry.covariance + self.weight * slam.covariance
        return GaussianPose(mean, covariance)
