"""What the calibration of a recording has left in its images, by how odometry's tracks fit together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import EstimationError
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.vo.calibration_pairs import NAMES, NUMBERS, CalibrationPairs
from fvslam_graph.vo.odometry import VisualOdometry

MIN_PAIRS = 10
PASSES = 5


@dataclass(frozen=True)
class RecordingCalibration:
    """A camera as its own recording shows it.

    Attributes:
        camera: Of the images as the calibration undistorts them; it differs only by what is certain.
        sigmas: (8,) standard deviations of its fx, fy, cx, cy, k1, k2, p1 and p2.
        pairs: How many pairs of images tell it.
        corrected: Names of the numbers by which it differs.
    """

    camera: Camera
    sigmas: NDArray[np.float64]
    pairs: int
    corrected: tuple[str, ...]

    @property
    def origin(self) -> str:
        """What it is by."""
        return f"{self.pairs} pairs of images of a flight; certain: {', '.join(self.corrected) or 'nothing'}"


def calibrate_by_tracks(sequence: Sequence) -> RecordingCalibration:
    """The calibration by odometry on all frames of a recording.

    What is wrong makes outliers of the points that tell most about it. So what is certain is taken out, and what is
    left is measured again, until this is less than its deviation.

    Raises:
        EstimationError: The camera has hardly moved.
    """
    errors, certain = np.zeros(NUMBERS), np.zeros(NUMBERS, bool)
    for _ in range(PASSES):
        pairs = _pairs(sequence.recalibrated(sequence.camera.corrected(errors)) if errors.any() else sequence)
        if pairs.count < MIN_PAIRS:
            raise EstimationError(
                f"{sequence.name} does not tell its calibration: it has {pairs.count} pairs of images between which "
                f"the camera moved enough, {MIN_PAIRS} are needed"
            )
        left = pairs.estimate()
        certain |= left.certain
        more = left.likeliest(certain)
        errors += more
        if np.all(np.abs(more) < left.sigmas):
            break
    camera = sequence.camera
    focal, k1, k2, right, down, p1, p2 = left.sigmas
    sigmas = np.array([focal * camera.fx, focal * camera.fy, right * camera.fx, down * camera.fy, k1, k2, p1, p2])
    corrected = tuple(name for name, known in zip(NAMES, certain, strict=True) if known)
    return RecordingCalibration(camera.corrected(errors), sigmas, pairs.count, corrected)


def _pairs(sequence: Sequence) -> CalibrationPairs:
    pairs, vo = CalibrationPairs(), VisualOdometry(sequence.camera, load_config(settings=["scale.source=unit"]))
    for frame in sequence:
        if (evidence := vo.step(frame).evidence) is not None:
            pairs.add(evidence)
    return pairs
