"""The factor graph as files that other programs read: g2o, PLY, and GTSAM's own serialisation."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.files import replacing, write_file
from fvslam_graph.core.frame_result import FACTORS, G2O, LANDMARKS_PLY, VALUES
from fvslam_graph.graph.calibration import CALIBRATION, EXACT_SIGMA
from fvslam_graph.graph.factors import is_filed, is_landmark, is_pose, length_factor, pose_key

Lengths = Mapping[tuple[int, int], tuple[float, float]]
"""Metres and deviation of motions between two frames."""


def write_graph(folder: Path, factors: gtsam.NonlinearFactorGraph, estimate: gtsam.Values, lengths: Lengths) -> None:
    """Write poses and motions as g2o, which knows no pixels; landmarks as PLY; all of it as GTSAM does.

    `graph.gtsam` and `values.gtsam` hold poses, landmarks and the camera; read back, they have the same optimum. Scale
    and calibration are held there as the graph has found them, since GTSAM has no serialisation of linear factors, nor
    of our own. Nor has it one of EssentialMatrixConstraint: a graph with such factors has no `graph.gtsam`.

    Args:
        folder: Exists.
        factors, estimate: Of the solver.
        lengths: Of motions whose length is not in their own factor, with the scale that was found.

    Raises:
        OSError: A file cannot be written.
    """
    values, poses, points = gtsam.Values(), gtsam.Values(), []
    for key in estimate.keys():  # noqa: SIM118
        if is_pose(key):
            values.insert(key, estimate.atPose3(key))
            poses.insert(gtsam.Symbol(key).index(), estimate.atPose3(key))
        elif is_landmark(key):
            values.insert(key, estimate.atPoint3(key))
            points.append(estimate.atPoint3(key))
        elif key == CALIBRATION:
            values.insert(key, estimate.atCal3Bundler(key))
    whole, motions = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph()
    for slot in range(factors.size()):
        factor = factors.at(slot)
        if isinstance(factor, gtsam.BetweenFactorPose3) and is_filed(factor.keys()[1]):
            factor = _calibrated(factor, estimate) if all(map(estimate.exists, factor.keys())) else None
        if factor is None or not all(values.exists(key) for key in factor.keys()):  # noqa: SIM118
            continue
        whole.add(factor)
        if isinstance(factor, gtsam.BetweenFactorPose3):
            motions.add(_plain(factor, lengths))
    if values.exists(CALIBRATION):
        exact = gtsam.noiseModel.Isotropic.Sigma(3, EXACT_SIGMA)
        whole.add(gtsam.PriorFactorCal3Bundler(CALIBRATION, values.atCal3Bundler(CALIBRATION), exact))
    for (first, second), (metres, sigma) in lengths.items():
        if values.exists(pose_key(first)):
            whole.add(length_factor(first, second, metres, sigma))
    with replacing(folder / G2O) as path:
        gtsam.writeG2o(motions, poses, str(path))
        if path.read_bytes().count(b"\n") != poses.size() + motions.size():  # GTSAM does not say that a disk is full
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
    kinds = {type(whole.at(slot)) for slot in range(whole.size())}
    if gtsam.EssentialMatrixConstraint not in kinds:
        write_file(folder / FACTORS, whole.serialize())
    write_file(folder / VALUES, values.serialize())
    write_file(folder / LANDMARKS_PLY, _ply(np.array(points).reshape(-1, 3)))


def _calibrated(factor: gtsam.BetweenFactorPose3, estimate: gtsam.Values) -> gtsam.BetweenFactorPose3:
    """A motion to where the camera would be by the calibration of the file, as it is with the one that was found."""
    first, filed = factor.keys()
    second = pose_key(gtsam.Symbol(filed).index())
    start, motion = estimate.atPose3(first), estimate.atPose3(first).between(estimate.atPose3(second))
    error = factor.measured().localCoordinates(start.between(estimate.atPose3(filed)))
    return gtsam.BetweenFactorPose3(first, second, motion.compose(gtsam.Pose3.Expmap(-error)), factor.noiseModel())


def _plain(factor: gtsam.BetweenFactorPose3, lengths: Lengths) -> gtsam.BetweenFactorPose3:
    """The same with its length and without its kernel, between poses numbered by their frames: what g2o can hold."""
    first, second = (gtsam.Symbol(key).index() for key in factor.keys())  # noqa: SIM118
    noise = factor.noiseModel()
    if isinstance(noise, gtsam.noiseModel.Robust):
        noise = noise.noise()
    motion = factor.measured()
    if (first, second) in lengths:
        metres, sigma = lengths[first, second]
        direction = motion.translation() / np.linalg.norm(motion.translation())
        travel = np.concatenate([np.zeros(3), motion.rotation().unrotate(direction)])
        noise = gtsam.noiseModel.Gaussian.Information(noise.information() + np.outer(travel, travel) / sigma**2)
        motion = gtsam.Pose3(motion.rotation(), metres * direction)
    return gtsam.BetweenFactorPose3(first, second, motion, noise)


def _ply(points: NDArray[np.float64]) -> str:
    """Points (N, 3) as a PLY file."""
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    header = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{axes}end_header\n"
    return header + "".join(f"{x:.4f} {y:.4f} {z:.4f}\n" for x, y, z in points)
