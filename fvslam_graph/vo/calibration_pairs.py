"""What pairs of images say of the calibration together, where each errs by more than its residuals show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.vo_estimate import CalibrationEvidence

Array = NDArray[np.float64]

# Of these, as a logarithm the first, and in focal lengths the principal point.
NAMES = ("focal length", "k1", "k2", "cx", "cy", "p1", "p2")
PRIOR_SIGMAS = np.array([0.01, 0.05, 0.05, 0.01, 0.01, 0.005, 0.005])  # by which files err
NUMBERS = len(PRIOR_SIGMAS)
CERTAIN = 5.0  # standard deviations from what the file says


class CalibrationPairs:
    """Sums up what pairs of images say of a calibration, and how they differ.

    A pair's residuals also hold what neighbouring tracks share, which passes for a small error of the calibration, and
    is not the same in each pair. So pairs count for less along what they differ in.
    """

    def __init__(self) -> None:
        self._all, self._new = _Sums(), _Sums()
        shape = (NUMBERS, NUMBERS)
        # Second moments.
        self._scores, self._mixed, self._informations = (np.zeros((*shape, *more)) for more in ((), (NUMBERS,), shape))

    @property
    def count(self) -> int:
        """How many pairs."""
        return self._all.count

    def add(self, evidence: CalibrationEvidence) -> None:
        """Take in what a pair says, about the calibration of the file."""
        information = evidence.information * np.outer(PRIOR_SIGMAS, PRIOR_SIGMAS)
        score = evidence.gradient * PRIOR_SIGMAS
        for sums in (self._all, self._new):
            sums.add(information, score)
        self._scores += np.outer(score, score)
        self._mixed += np.multiply.outer(information, score)
        self._informations += np.multiply.outer(information, information)

    def estimate(self) -> CalibrationErrors:
        """What they say together, with the prior that files are right as a rule. There must be two pairs."""
        return CalibrationErrors(*self._all.tempered(self._variances()))

    def gain(self, errors: Array) -> float:
        """Log likelihood that a pair gains in the mean, if the file errs so, (7,)."""
        scaled = errors / PRIOR_SIGMAS
        return float(scaled @ self._all.score - 0.5 * scaled @ self._all.information @ scaled) / self.count

    def news(self, first: int) -> CalibrationEvidence:
        """What pairs since the last call say of the `first` numbers, whatever the others are."""
        errors = CalibrationErrors(*self._new.tempered(self._variances() * self._new.count / self.count))
        self._new = _Sums()
        return errors.evidence(first)

    def _variances(self) -> Array:
        """(7, 7) of the score of all pairs: with the prior, their information, and more along what they differ in.

        A few pairs do not tell along what; as many as there are numbers are taken to differ along all alike.
        """
        posterior, count = self._all.information + np.eye(NUMBERS), self.count
        mean = np.linalg.solve(posterior, self._all.score)
        mixed = np.einsum("ijk,j->ik", self._mixed, mean)
        spread = self._scores - mixed - mixed.T + np.einsum("ijkl,j,l->ik", self._informations, mean, mean)
        root = np.linalg.cholesky(posterior)
        whitening = np.linalg.inv(root)
        differing = whitening @ spread @ whitening.T * count / (count - 1)
        alike = max(np.trace(differing) / NUMBERS, 1.0) * np.eye(NUMBERS)
        values, axes = np.linalg.eigh((count * differing + NUMBERS * alike) / (count + NUMBERS))
        variances: Array = root @ (axes * np.maximum(values, 1.0)) @ axes.T @ root.T
        return variances


@dataclass(frozen=True)
class CalibrationErrors:
    """Errors of the calibration of the file, as far as pairs tell, in units of the prior's deviations.

    Attributes:
        information: (7, 7) without the prior,
        score: and (7,) the gradient of the log likelihood where the file is right.
    """

    information: Array
    score: Array

    @property
    def sigmas(self) -> Array:
        """(7,) standard deviations, whatever the other numbers are."""
        return np.asarray(PRIOR_SIGMAS * np.sqrt(self._covariance.diagonal()))

    @property
    def certain(self) -> NDArray[np.bool_]:
        """(7,) which numbers are off for certain, whatever the others are."""
        return np.asarray(np.abs(PRIOR_SIGMAS * (self._covariance @ self.score)) > CERTAIN * self.sigmas)

    def likeliest(self, free: NDArray[np.bool_]) -> Array:
        """The most likely errors (7,) if only some (7,) of the numbers can be off."""
        errors, among = np.zeros(NUMBERS), np.ix_(free, free)
        errors[free] = np.linalg.solve((self.information + np.eye(NUMBERS))[among], self.score[free])
        return np.asarray(PRIOR_SIGMAS * errors, float)

    def evidence(self, first: int) -> CalibrationEvidence:
        """What is said of the first numbers, whatever the others are, without a prior of theirs."""
        kept, others = slice(first), slice(first, None)
        posterior = self.information + np.eye(NUMBERS)
        through = self.information[kept, others] @ np.linalg.inv(posterior[others, others])
        information = self.information[kept, kept] - through @ self.information[others, kept]
        gradient = self.score[kept] - through @ self.score[others]
        sigmas = PRIOR_SIGMAS[kept]
        return CalibrationEvidence(information / np.outer(sigmas, sigmas), gradient / sigmas)

    @property
    def _covariance(self) -> Array:
        return np.asarray(np.linalg.inv(self.information + np.eye(NUMBERS)), float)


class _Sums:
    """Sums over pairs, in units of the prior's standard deviations."""

    def __init__(self) -> None:
        self.count = 0
        self.information, self.score = np.zeros((NUMBERS, NUMBERS)), np.zeros(NUMBERS)

    def add(self, information: Array, score: Array) -> None:
        self.count += 1
        self.information += information
        self.score += score

    def tempered(self, variances: Array) -> tuple[Array, Array]:
        """Information and score, if the score has larger variances (7, 7) than its information says."""
        share = np.linalg.solve(variances, self.information).T
        return share @ self.information, share @ self.score
