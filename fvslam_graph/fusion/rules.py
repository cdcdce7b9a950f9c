"""Rules that make one motion of two: the paper's weighted mean, and covariance intersection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import gtsam
import numpy as np

from fvslam_graph.core.errors import EstimationError
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.outside import require_pose
from fvslam_graph.core.trajectory import interpolate

NEGATIVE = 1e-9  # of a variance (rad^2, m^2), by which rounding may make one negative


class FusionRule(Protocol):
    """Makes one estimate of the motion since the last reference P_f out of two, whose correlation is not known.

    Both subsystems start at P_f, so that fusing their motions is fusing their poses, without the uncertainty that P_f
    brings into both.
    """

    def __call__(self, odometry: GaussianPose, slam: GaussianPose) -> GaussianPose:
        """The fused motion, from that of visual odometry (O_f) and that of visual SLAM (S_f)."""


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


@dataclass(frozen=True)
class Intersection:
    """The weighted mean of the information, with the weight that leaves the smallest covariance.

    Source: Julier, Uhlmann, "A non-divergent estimation algorithm in the presence of unknown correlations", ACC 1997;
    on the tangent space of the first estimate.

    Attributes:
        criterion: What is smallest: the determinant, or the trace with each direction in units of its mean variance.
    """

    criterion: Literal["determinant", "trace"] = "determinant"

    def __call__(self, odometry: GaussianPose, slam: GaussianPose) -> GaussianPose:
        """The intersection; its covariance holds for any correlation of the two."""
        from scipy.optimize import minimize_scalar  # which takes half as long to load as all else together

        # Radians and metres are made comparable, so that neither decides, nor a direction of almost no variance.
        units = np.sqrt(np.maximum(np.diag(odometry.covariance + slam.covariance) / 2, 1e-18))
        scale = np.outer(units, units)
        ours, theirs = (np.linalg.inv(pose.covariance / scale + 1e-12 * np.eye(6)) for pose in (odometry, slam))

        def size(weight: float) -> float:
            information = (1 - weight) * ours + weight * theirs
            if self.criterion == "trace":
                return float(np.trace(np.linalg.inv(information)))
            return -float(np.linalg.slogdet(information)[1])

        weight = minimize_scalar(size, bounds=(0.0, 1.0), method="bounded").x
        covariance = np.linalg.inv((1 - weight) * ours + weight * theirs)
        apart = odometry.mean.localCoordinates(slam.mean) / units
        step = units * (covariance @ (weight * theirs @ apart))
        covariance = (covariance + covariance.T) / 2 * scale
        return GaussianPose(odometry.mean.compose(gtsam.Pose3.Expmap(step)), covariance)


@dataclass(frozen=True)
class OutsideRule:
    """A rule of another package, whose results are checked.

    Attributes:
        name: For errors.
        rule: It.
    """

    name: str
    rule: FusionRule

    def __call__(self, odometry: GaussianPose, slam: GaussianPose) -> GaussianPose:
        """The fused motion.

        Raises:
            EstimationError: It is no pose with a covariance.
        """
        fused = self.rule(odometry, slam)
        require_pose(self.name, fused, "of two motions")
        if not np.isfinite(fused.covariance).all() or np.linalg.eigvalsh(fused.covariance)[0] < -NEGATIVE:
            raise EstimationError(f"{self.name} returns a covariance that is not finite, or negative in a direction")
        return fused
