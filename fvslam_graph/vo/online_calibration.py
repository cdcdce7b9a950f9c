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

Array = NDArray[np.float64]

# Of the logarithm of the focal length and of k1, as files err; and of k2, principal point, p1 and p2, which are not
# estimated, but pass for these: in a turn, a principal point that is off looks like a wrong focal length.
PRIOR_SIGMAS = np.array([0.01, 0.05])
OTHER_SIGMAS = np.array([0.05, 0.01, 0.01, 0.005, 0.005])
MIN_PAIRS = 5
CERTAIN = 5.0  # standard deviations from what the file says
GROSS = 3.0  # log likelihood that a pair of images gains in the mean

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
    """Sums up what pairs of images say of the calibration, and rectifies images again where it is wrong.

    A pair's residuals also hold what neighbouring tracks share, which passes for a small error of the calibration. So
    the file is believed until its error is certain, and so large that it shows in single pairs.

    Args:
        camera: As its file has it, undistorted.
        enabled: Whether the calibration is corrected at all.
    """

    def __init__(self, camera: Camera, enabled: bool = True) -> None:
        self.applied = np.zeros(2)  # what is added to the file's
        self._camera, self._enabled = camera, enabled
        self._before: Recalibration | None = None
        self._now: Recalibration | None = None
        self._pairs, self._next = _Pairs(), MIN_PAIRS
        self._estimated = np.zeros(2, bool)  # what was certain once
        self._known = CalibrationEvidence(np.zeros((2, 2)), np.zeros(2))  # what had a part in the last correction

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
        self._pairs.add(evidence.information, evidence.gradient + evidence.information[:, :2] @ self.applied)
        if self._pairs.count < self._next:
            return None
        correction = self._pairs.correction(self._known, self._estimated)
        if self._now is None:
            gain = 0.5 * correction.mean @ self._pairs.information @ correction.mean / self._pairs.count
            if gain < GROSS:
                return None
            self._warn(correction)
            self._pairs = _Pairs()  # these were linearised where the calibration was wrong
        else:
            self._known = CalibrationEvidence(self._pairs.information.copy(), self._pairs.score.copy())
            self._next = 2 * self._pairs.count
        self.applied = correction.mean
        self._estimated |= correction.mean != 0
        self._before, self._now = self._now, Recalibration(self._camera, *correction.mean)
        return correction

    def _warn(self, correction: CalibrationCorrection) -> None:
        focal, k1 = self._camera.fx * math.exp(correction.mean[0]), correction.mean[1]
        _log.warning(
            "the images do not fit their calibration; from here on they are rectified with a focal length of about "
            "%.1f pixels and k1 = %.4f +- %.4f; calibrate the camera",
            *(focal, k1, correction.sigmas[1]),
        )


class _Pairs:
    """Sums over pairs of images: what they say of the calibration of the file, and how they differ."""

    def __init__(self) -> None:
        self.count = 0
        self._all, self._all_score = np.zeros((7, 7)), np.zeros(7)  # information, and gradient of the likelihood
        # Second moments of both, of the two numbers that are estimated.
        self._scores, self._mixed, self._informations = np.zeros((2, 2)), np.zeros((2, 2, 2)), np.zeros((2, 2, 2, 2))

    @property
    def information(self) -> Array:
        """(2, 2) of the two numbers that are estimated, if all others are right."""
        return self._all[:2, :2]

    @property
    def score(self) -> Array:
        """(2,) gradient of the log likelihood, of these."""
        return self._all_score[:2]

    def add(self, information: Array, score: Array) -> None:
        """Take in a pair: (7, 7) and (7,)."""
        self.count += 1
        self._all += information
        self._all_score += score
        information, score = information[:2, :2], score[:2]
        self._scores += np.outer(score, score)
        self._mixed += np.multiply.outer(information, score)
        self._informations += np.multiply.outer(information, information)

    def correction(self, known: CalibrationEvidence, estimated: NDArray[np.bool_]) -> CalibrationCorrection:
        """The most likely one; pairs differ by more than their residuals say, and all count for less.

        Args:
            known: What had a part in an earlier one.
            estimated: (2,) what is corrected in any case; else only what is certain, whatever the other numbers are.
        """
        dispersion = self._dispersion(self._likeliest(np.ones(2, bool)))
        whole = np.linalg.inv(self._all + np.diag(np.append(PRIOR_SIGMAS, OTHER_SIGMAS) ** -2))
        sigmas = np.sqrt(dispersion * whole.diagonal()[:2])
        certain = np.abs((whole @ self._all_score)[:2]) > CERTAIN * sigmas
        news = CalibrationEvidence(
            (self.information - known.information) / dispersion, (self.score - known.gradient) / dispersion
        )
        return CalibrationCorrection(self._likeliest(estimated | certain), sigmas, news)

    def _likeliest(self, free: NDArray[np.bool_]) -> Array:
        """Correction (2,) where only some of both numbers are free."""
        mean, among = np.zeros(2), np.ix_(free, free)
        mean[free] = np.linalg.solve((self.information + np.diag(PRIOR_SIGMAS**-2))[among], self.score[free])
        return mean

    def _dispersion(self, mean: Array) -> float:
        """Factor of variances by which pairs differ from a correction, where they differ by more than residuals say."""
        mixed = np.einsum("ijk,j->ik", self._mixed, mean)
        spread = self._scores - mixed - mixed.T + np.einsum("ijkl,j,l->ik", self._informations, mean, mean)
        inverse = np.linalg.inv(self.information + np.diag(PRIOR_SIGMAS**-2))
        return max(float(np.trace(spread @ inverse)) / 2 * self.count / (self.count - 1), 1.0)
