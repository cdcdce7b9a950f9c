"""A motion against the keyframe; and those that no parallax measures, of a camera that stands or turns."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.gates import chi2_gate
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.inverse_depths import MetricMap
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.core.vo_estimate import CalibrationEvidence, ScaleStep

# Above a plane, a rotation looks like a translation: it leaves about this fraction of its image motion unexplained.
ROTATION_AMBIGUITY = 0.1
APART = chi2_gate(0.9999, 3)  # of the step between two places


@dataclass(frozen=True)
class KeyframeMotion:
    """A measured motion against the keyframe.

    Attributes:
        keyframe_T_cur: Pose and its covariance.
        tracks: Those that agree with it.
        map: Of the keyframe, with what was learnt.
        scale: Of the baseline, where it was estimated.
        parallax: Median image motion that no rotation explains, pixels; NaN where not measured.
        near_parallax: That of what is near enough to show a translation; likewise.
        J_calibration: (6, 2) how the pose changes with the logarithm of the focal length and with k1.
        evidence: What two views say of these.
        errors: (5, 5) what the last five of the errors that the map's depths share add to rotation and direction; None
            where they add nothing.
        noise: Pixels, standard deviation of a corner's displacement along each axis; NaN where not measured.
    """

    keyframe_T_cur: GaussianPose
    tracks: Tracks
    map: MetricMap
    scale: ScaleStep | None = None
    parallax: float = math.nan
    near_parallax: float = math.nan
    J_calibration: NDArray[np.float64] = field(default_factory=lambda: np.zeros((6, 2)))
    evidence: CalibrationEvidence | None = None
    errors: NDArray[np.float64] | None = None
    noise: float = math.nan


def relative_variance(motion: KeyframeMotion) -> float:
    """The variance of the translation, apart from its scale, as a share of its squared length."""
    pose = motion.keyframe_T_cur.with_scale_variance(-motion.map.variance)
    return float(np.trace(pose.covariance[3:, 3:]) / max(np.sum(pose.mean.translation() ** 2), 1e-12))


def are_apart(first: KeyframeMotion, second: KeyframeMotion) -> bool:
    """Whether two motions against the same keyframe lead to places that cannot be one.

    The scale of the map is not in question: both err by the same.
    """
    step = first.keyframe_T_cur.mean.transformTo(second.keyframe_T_cur.mean.translation())
    noise = np.zeros((3, 3))
    for motion in (first, second):
        pose = motion.keyframe_T_cur
        noise += pose.with_scale_variance(-pose.room_for_scale(first.map.variance)).covariance[3:, 3:]
    return bool(step @ np.linalg.solve(noise, step) > APART)


def with_planar_ambiguity(motion: GaussianPose, depth: float) -> GaussianPose:
    """A motion that may be the wrong one of the two that explain a plane: it is as uncertain as it is large.

    Args:
        motion: keyframe_T_cur.
        depth: Metres to what is seen.
    """
    metres = float(np.linalg.norm(motion.mean.translation()))
    sigmas = np.repeat([metres / depth, metres], 3)
    return GaussianPose(motion.mean, motion.covariance + np.diag(sigmas**2))


def standing(rotation: gtsam.Rot3, hidden: float, depth: float) -> GaussianPose:
    """A step of a camera that stands and may be shaken, as uncertain as a parallax that counts as none.

    Args:
        rotation: previous_R_current.
        hidden: This parallax, radians.
        depth: Metres to what is seen.
    """
    sigmas = np.repeat([hidden, hidden * depth], 3)
    return GaussianPose(gtsam.Pose3(rotation, np.zeros(3)), np.diag(sigmas**2))


def turning(rotation: gtsam.Rot3, hidden: float, depth: float, expected: GaussianPose) -> GaussianPose:
    """A rotation that explains all tracks, with a translation between none and the one that is expected.

    Args:
        rotation: keyframe_R_cur.
        hidden: Parallax in which a translation may hide, radians.
        depth: Metres to what is seen.
        expected: keyframe_T_cur by the motion model.
    """
    hidden = hidden / ROTATION_AMBIGUITY
    covariance = np.diag(np.repeat([hidden, hidden * depth], 3) ** 2)
    axes = rotation.matrix().T @ expected.mean.rotation().matrix()  # of what is expected, in the new camera
    forecast, seen = axes @ expected.covariance[3:, 3:] @ axes.T, covariance[3:, 3:]
    gain = seen @ np.linalg.inv(forecast + seen)  # of the forecast, beside none at all
    translation = rotation.rotate(gain @ rotation.unrotate(expected.mean.translation()))
    covariance[3:, 3:] = gain @ forecast
    return GaussianPose(gtsam.Pose3(rotation, translation), covariance)
