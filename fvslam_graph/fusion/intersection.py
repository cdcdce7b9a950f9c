"""Covariance intersection: the fusion of two estimates whose correlation is not known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import gtsam
import numpy as np
from scipy.optimize import minimize_scalar

from fvslam_graph.core.gaussian_pose import GaussianPose


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
