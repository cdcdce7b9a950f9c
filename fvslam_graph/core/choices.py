"""What users choose by name; nothing else is imported here, so that `fvslam --help` can list it quickly."""

from enum import StrEnum


class Preset(StrEnum):
    """The settings to start from."""

    PAPER = "paper"
    TUNED = "tuned"


class Mode(StrEnum):
    """The estimators of the poses that this package has; see `modes.outside_mode` for others."""

    VO = "vo"  # visual odometry alone
    VSLAM = "vslam"  # EKF visual SLAM alone; visual odometry only starts it
    AVERAGE = "average"  # the paper: both, fused by their weighted mean at every interleaved frame
    INTERSECTION = "intersection"  # both, fused by covariance intersection
    GRAPH = "graph"  # the measurements of both in one factor graph


class ScaleSource(StrEnum):
    """Where metres come from."""

    PLANE = "plane"  # known distance to the ground plane
    MAP = "map"  # relative: tracks that two consecutive pairs have in common; the first scale is a guess
    ORACLE = "oracle"  # the ground truth
    UNIT = "unit"  # every baseline is 1 m


RELATIVE_SOURCES = (ScaleSource.MAP, ScaleSource.UNIT)  # nothing tells metres, and the first scale is a convention
