"""A calibration that is found wrong while the camera moves: focal length and radial distortion, by pairs of images."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Recalibration
from fvslam_graph.core.sequence import Frame
from fvslam_graph.core.vo_estimate import CalibrationEvidence
from fvslam_graph.vo.calibration_pairs import NUMBERS, CalibrationPairs

Array = NDArray[np.float64]

CORRECTED = 2  # of the numbers, the first: the logarithm of the focal length, and k1
MIN_PAIRS = 5
GROWTH = 1.25  # of the number of pairs, until they are looked at again; where they have corrected something already,
GROWTH_CORRECTED = 2.0  # as each correction begins a new map
GROSS = 3.0  # log likelihood that a pair of images gains in the mean, each time they are looked at,
LOOKS = 2  # as often in a row: the first estimate that is certain is the one that errs most

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class CalibrationCorrection:
    """What is to be added to the calibration of the file from now on.

    Attributes:
        mean: (2,) to the logarithm of the focal length and to k1; nothing to one that never was certain.
        sigmas: (2,) standard deviations, by how much pairs of images differ, whatever else of the calibration is wrong.
        news: What pairs say of it that had no part in the correction before.
    """

    mean: Array
    sigmas: Array
    news: CalibrationEvidence


class OnlineCalibration:
    """Rectifies images again where pairs of them show that their calibration is wrong.

    A new calibration bends the path where it comes in. So the file is believed until its error is certain, and so large
    that it shows in single pairs. What is certain and small corrects the scale, which bends nothing.

    Args:
        camera: As its file has it, undistorted.
        enabled: Whether the calibration is corrected at all.

    Attributes:
        applied: (2,) what is added to the file's logarithm of the focal length and to its k1,
        left: and what would have to be added to those of the rectified images, as far as it is certain.
    """

    def __init__(self, camera: Camera, enabled: bool = True) -> None:
        self.applied, self.left = np.zeros(CORRECTED), np.zeros(CORRECTED)
        self._camera, self._enabled = camera, enabled
        self._before: Recalibration | None = None
        self._now: Recalibration | None = None
        self._pairs, self._next = CalibrationPairs(), MIN_PAIRS
        self._gross = 0  # looks in a row

    def rectified(self, frame: Frame) -> Frame:
        """A frame as its file has it, by the calibration as it is known now."""
        if self._now is None or frame.image is None:
            return frame
        return replace(frame, image=self._now(frame.image))

    def filed(self, pixels: Array) -> Array:
        """Where pixels (N, 2) of a rectified image are in the image of the file."""
        return pixels if self._now is None else self._now.filed(pixels)

    def moved(self, pixels: Array) -> Array:
        """Where pixels (N, 2) of an image as it was rectified before the last correction are since."""
        before = pixels if self._before is None else self._before.filed(pixels)
        return before if self._now is None else self._now.corrected(before)

    def add(self, evidence: CalibrationEvidence | None) -> CalibrationCorrection | None:
        """Take in a pair of images, if there is one; the correction that follows, or None where all stays as it is."""
        if evidence is None or not self._enabled:
            return None
        about_file = evidence.gradient + evidence.information[:, :CORRECTED] @ self.applied
        self._pairs.add(CalibrationEvidence(evidence.information, about_file))
        if self._pairs.count < self._next:
            return None
        self._next = math.ceil((GROWTH if self._now is None else GROWTH_CORRECTED) * self._pairs.count)
        errors = self._pairs.estimate()
        free = (np.arange(NUMBERS) < CORRECTED) & errors.certain
        free[:CORRECTED] |= self.applied != 0
        mean = errors.likeliest(free)
        if self._now is None:
            self._gross = self._gross + 1 if self._pairs.gain(mean) >= GROSS else 0
            if self._gross < LOOKS:
                self.left = mean[:CORRECTED]
                return None
        correction = CalibrationCorrection(mean[:CORRECTED], errors.sigmas[:CORRECTED], self._pairs.news(CORRECTED))
        if self._now is None:
            self._warn(correction)
            self._pairs, self._next = CalibrationPairs(), MIN_PAIRS  # these were linearised where it was wrong
        self.applied, self.left = correction.mean, np.zeros(CORRECTED)
        self._before, self._now = self._now, Recalibration(self._camera, self._camera.corrected(mean))
        return correction

    def _warn(self, correction: CalibrationCorrection) -> None:
        focal, k1 = self._camera.fx * math.exp(correction.mean[0]), correction.mean[1]
        _log.warning(
            "the images do not fit their calibration; from here on they are rectified with a focal length of about "
            "%.1f pixels and k1 = %.4f +- %.4f; calibrate the camera",
            *(focal, k1, correction.sigmas[1]),
        )
