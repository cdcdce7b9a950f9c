"""NEES of the motions of a run, as far as its reference can judge them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fvslam_graph.evaluation.nees import Consistency, MotionErrors, consistency
from fvslam_graph.evaluation.reference_quality import ReferenceQuality


def motion_nees(motions: MotionErrors, quality: ReferenceQuality) -> dict[str, Consistency]:
    """NEES of the "pose", its "rotation" and the "direction" of its translation; of no motions, nothing.

    Args:
        motions: That have a covariance.
        quality: Of the reference.
    """
    if not len(motions):
        return {}
    lengths = motions.lengths
    noise = quality.motion_sigmas(lengths)
    rotation = slice(0, 3)
    nees = {
        "pose": consistency(motions.errors, motions.covariances, noise),
        "rotation": consistency(
            motions.errors[:, rotation], motions.covariances[:, rotation, rotation], noise[:, rotation]
        ),
    }
    known, errors, covariances = motions.directions()
    if len(known):
        nees["direction"] = consistency(errors, covariances, noise[known, 3:5] / lengths[known, None])
    if not quality.tilt:
        return nees
    return {part: replace(found, judged=found.mean <= found.high) for part, found in nees.items()}


def unjudged(quality: ReferenceQuality, nees: dict[str, Consistency]) -> list[str]:
    """A sentence on why the reference does not judge some NEES; none where it judges all."""
    parts = {part: found for part, found in nees.items() if not found.judged}
    if not parts:
        return []
    tilt = f"its axes are turned from the camera's by {np.degrees(quality.tilt):.2g} deg" if quality.tilt else ""
    added = ", ".join(f"{found.added:.3g} to the {found.dof:.2g} of the {part}" for part, found in parts.items())
    noise = (
        f"it errs by {1000 * quality.position:.2g} mm and {np.degrees(quality.rotation):.2g} deg from frame to "
        f"frame, by its jitter that the images do not show, which alone adds {added}"
    )
    return [f"the reference cannot judge the NEES of {', '.join(parts)}: {tilt or noise}"]
