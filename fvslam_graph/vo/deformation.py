"""Tracks without what the change of view makes their tracker err."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.inverse_depths import InverseDepths
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.vo.epipolar import MatchedRays

SHARE = 0.3  # of a shift, that it errs by: patches face the keyframe only roughly; by residuals on roads,
CORNER_NOISE = 0.1  # where corners err by so many pixels otherwise
MAX_SHIFT = 2.0  # pixels along each axis: more than that is an edge, along which little tells where a patch is
NEAREST = 0.5  # times as far away as in the keyframe: what comes nearer is no longer followed


def undeformed(
    tracks: Tracks, matched: MatchedRays, rotation: gtsam.Rot3, baseline: NDArray[np.float64], depths: InverseDepths
) -> Tracks:
    """The tracks where the middles of their patches are, if these are planes that face the keyframe.

    Args:
        tracks: N, with an `alignment_bias`; without one, they are right as they are.
        matched: (N,) their rays in both views.
        rotation: keyframe_R_cur.
        baseline: (3,) from the keyframe to the current camera, in the keyframe, in the unit of the depths.
        depths: (N,) in the keyframe. What of them is noise is taken to be far away, where nothing comes nearer.
    """
    if tracks.alignment_bias is None:
        return tracks
    information = depths.values**2 / np.maximum(depths.values**2 + depths.sigmas**2, 1e-18)
    near = information * depths.values.clip(min=0.0)
    R = rotation.matrix().T
    # A point at x + d in the keyframe, at the depth of x, is seen at R (x + d - t / depth).
    depth_ratio = matched.previous @ R[2] - near * float(R[2] @ baseline)
    stretched = R[:2, :2] - matched.current[:, :2, None] * R[2, :2]
    turned = gtsam.Rot2(tracks.turn).matrix()
    deformation = turned.T @ stretched / np.maximum(depth_ratio, NEAREST)[:, None, None] - np.eye(2)
    shift = np.einsum("nijk,njk->ni", tracks.alignment_bias, deformation).clip(-MAX_SHIFT, MAX_SHIFT) @ turned.T
    doubt = (SHARE / CORNER_NOISE) ** 2 * shift[:, :, None] * shift[:, None, :]
    return replace(tracks, current=tracks.current - shift, covariances=tracks.covariances + doubt)
