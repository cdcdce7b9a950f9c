"""How far a reference can be trusted from frame to frame, as it and the estimate themselves tell.

A NEES far above its band may be the fault of the reference: satellite positions jump, and the axes of a motion capture
are not the camera's. Third differences of a path are its jitter. What of it the images show, too, is motion; the rest
is noise of the reference, or of the estimate. With independent errors, the mean of r (r - e), where r and e are the
jitter of both, is the variance of the reference's noise alone: neither real motion nor a bad estimate adds to it.

As the three-cornered hat of clocks, with the motion as the third: Gray and Allan, "A method for estimating the
frequency stability of an individual oscillator", 1974.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from fvslam_graph.evaluation.association import TrajectoryPairs
from fvslam_graph.runs.results import Relatives

Array = NDArray[np.float64]

ORDER = 3  # of the differences; on generated flights the fourth and fifth find the same, none
UNUSUAL = 5.0  # deviations of jitter that say nothing of what is usual
MIN_POSES = 20  # fewer tell no noise
MIN_TILT = np.radians(2.0)  # a bias of the estimate's direction is less


@dataclass(frozen=True)
class ReferenceQuality:
    """Errors of a reference from frame to frame.

    Attributes:
        rotation: Standard deviation of the noise of a pose along each axis, rad,
        position: and of its position, metres.
        tilt: Angle by which its axes seem turned from the camera's, rad; 0 where none shows.
    """

    rotation: float
    position: float
    tilt: float

    def motion_sigmas(self, lengths: Array) -> Array:
        """Standard deviations (N, 6) of motions between two of its poses that are `lengths` (N,) metres apart."""
        rotation = np.full_like(lengths, np.sqrt(2) * self.rotation)
        position = np.sqrt(2 * self.position**2 + (self.rotation * lengths) ** 2)
        return np.repeat(np.stack([rotation, position], axis=1), 3, axis=1)


def reference_quality(pairs: TrajectoryPairs, relatives: Relatives, scale: float) -> ReferenceQuality:
    """The quality of the reference of a run.

    Args:
        pairs: Its estimate are the poses of all frames that `relatives` is about.
        relatives: The estimated motions, whose path has no jumps, as online poses may have.
        scale: Factor that brings the estimate to the size of the reference.
    """
    path = _composed(relatives, scale)[pairs.indices]
    tilt = _tilt(path, pairs.reference.matrices)
    if len(path) < MIN_POSES:
        return ReferenceQuality(0.0, 0.0, tilt)
    weights = _differences(pairs.reference.stamps)
    reference, estimate = (_jitter(weights, poses) for poses in (pairs.reference.matrices, path))
    rotation, position = (_noise(r, e) for r, e in zip(reference, estimate, strict=True))
    return ReferenceQuality(rotation, position, tilt)


def _composed(relatives: Relatives, scale: float) -> Array:
    """The poses (N, 4, 4) of the path of all motions one after another."""
    steps = relatives.prev_T_cur.copy()
    steps[:, :3, 3] *= scale
    poses = np.tile(np.eye(4), (len(steps), 1, 1))
    for frame, previous in enumerate(relatives.previous):
        if previous < frame:
            poses[frame] = poses[previous] @ steps[frame]
    return poses


def _differences(stamps: Array) -> Array:
    """Weights (M, ORDER + 1) of the poses in each window, whose stamps (N,), seconds, need not be even.

    Polynomials below ORDER vanish; the weights have length one, so that independent errors keep their deviation.
    """
    times = sliding_window_view(stamps - stamps[0], ORDER + 1)
    apart = times[:, :, None] - times[:, None, :] + np.eye(ORDER + 1)
    weights = 1 / apart.prod(axis=2)
    normalised: Array = weights / np.linalg.norm(weights, axis=1, keepdims=True)
    return normalised


def _jitter(weights: Array, poses: Array) -> tuple[Array, Array]:
    """Differences of rotation (rad) and position (m), (M, 3) each, in the axes of the middle of each window."""
    from scipy.spatial.transform import Rotation

    windows = np.moveaxis(sliding_window_view(poses, ORDER + 1, axis=0), -1, 1)
    middle = windows[:, (ORDER + 1) // 2]
    back = middle[:, None, :3, :3].swapaxes(2, 3)
    rotations = Rotation.from_matrix((back @ windows[:, :, :3, :3]).reshape(-1, 3, 3)).as_rotvec()
    positions = back @ (windows[:, :, :3, 3] - middle[:, None, :3, 3])[..., None]
    shape = (*weights.shape, 3)
    rotation, position = (np.einsum("mj,mjc->mc", weights, part.reshape(shape)) for part in (rotations, positions))
    return rotation, position


def _noise(reference: Array, estimate: Array) -> float:
    """The deviation of the reference's own noise from the jitter (M, 3) of both."""
    apart = reference - estimate
    usual = np.ones(len(reference), bool)
    for jitter in (reference, apart):
        usual &= (np.abs(jitter) <= UNUSUAL * 1.4826 * np.median(np.abs(jitter))).all(axis=1)
    variance = np.mean((reference * apart)[usual]) if usual.any() else 0.0
    return float(np.sqrt(max(variance, 0.0)))


def _tilt(path: Array, reference: Array) -> float:
    """The angle between the axes of both, as the directions of travel tell; 0 where it is small, or does not last."""
    from scipy.spatial.transform import Rotation

    ours, theirs = (
        (poses[:-1, :3, :3].swapaxes(1, 2) @ np.diff(poses[:, :3, 3], axis=0)[:, :, None])[:, :, 0]
        for poses in (path, reference)
    )
    length, half = np.linalg.norm(theirs), len(ours) // 2
    if len(ours) < MIN_POSES or not (ours[:half].any() and ours[half:].any() and length):
        return 0.0
    parts = slice(None), slice(half), slice(half, None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a turn about the direction of travel is none that can be told
        whole, first, second = (Rotation.align_vectors(ours[part], theirs[part])[0].apply(theirs) for part in parts)
    tilt, change = np.linalg.norm(whole - theirs) / length, np.linalg.norm(second - first) / length
    return float(tilt) if tilt > MIN_TILT and change < tilt / 2 else 0.0
