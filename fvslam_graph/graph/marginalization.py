"""Marginalization of landmarks that are out of sight: one linear factor about the poses that saw them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.graph.calibration import CALIBRATION
from fvslam_graph.graph.factors import is_landmark, is_pose
from fvslam_graph.graph.landmark_candidates import MIN_DEPTH

MAX_DISTANCE = 1e6  # metres; a landmark known less well than that is not determined


class LandmarkMarginal:
    """Factors about poses, landmarks and the camera, from which the landmarks are eliminated.

    What is left is linear in what the poses have moved since. What moves a path most, a shift and a change of its
    scale, leaves what pixels say of it alone, so that little is lost.

    Args:
        factors: All that are about these landmarks.
        landmarks: Their keys.
        estimate: Of these variables, where factors are linearised and told from outliers.

    Attributes:
        landmarks: Their keys.
        factor: About the poses and the camera alone.
    """

    def __init__(self, factors: gtsam.NonlinearFactorGraph, landmarks: list[int], estimate: gtsam.Values) -> None:
        ordering = gtsam.Ordering()
        for landmark in landmarks:
            ordering.push_back(landmark)
        self._estimate, self.landmarks = estimate, landmarks
        self._by_poses, about_poses = gtsam.EliminateQR(factors.linearize(estimate), ordering)
        self.factor = gtsam.LinearContainerFactor(about_poses, estimate)

    @property
    def undetermined(self) -> list[int]:
        """Landmarks of which the factors do not tell where they are, whatever the poses."""
        sharpness = np.abs(np.diag(self._by_poses.R())).reshape(-1, 3).min(axis=1)  # 1/metres
        return [
            landmark for landmark, sharp in zip(self.landmarks, sharpness, strict=True) if not sharp > 1 / MAX_DISTANCE
        ]

    def insert_landmarks(self, values: gtsam.Values) -> None:
        """Add the landmarks to values of the poses, where they are most likely for these."""
        moved = gtsam.VectorValues()
        for key in self.factor.keys():  # noqa: SIM118
            at = gtsam.Values.atCal3Bundler if key == CALIBRATION else gtsam.Values.atPose3
            moved.insert(key, at(self._estimate, key).localCoordinates(at(values, key)))
        found = self._estimate.retract(self._by_poses.solve(moved))
        for landmark in self.landmarks:
            values.insert(landmark, found.atPoint3(landmark))


class Estimate(Protocol):
    """Where poses and landmarks are, and how the camera is."""

    def pose(self, key: int) -> gtsam.Pose3:
        """world_T_camera."""

    def point(self, key: int) -> NDArray[np.float64]:
        """In the world, (3,), metres."""

    def calibration(self) -> gtsam.Cal3Bundler:
        """The calibration of the camera."""

    def has(self, key: int) -> bool:
        """Whether a variable is there."""


class Marginalization:
    """Keeps the factors of landmarks in iSAM2, by their slots, and the marginals of landmarks no longer in it."""

    def __init__(self) -> None:
        self._of: dict[int, list[tuple[int, gtsam.NonlinearFactor]]] = {}
        self._marginals: list[LandmarkMarginal] = []

    def __iter__(self) -> Iterator[int]:
        """Landmarks that are not marginalized."""
        return iter(self._of)

    def add(self, factors: gtsam.NonlinearFactorGraph, slots: list[int]) -> None:
        """Factors that were taken in, in this order, in these slots."""
        for n, slot in enumerate(slots):
            factor = factors.at(n)
            for landmark in filter(is_landmark, factor.keys() if factor is not None else ()):  # None: it was removed
                self._of.setdefault(landmark, []).append((slot, factor))

    def seen_from(self, landmark: int) -> int:
        """The pose that saw it last."""
        poses: list[int] = [key for _, factor in self._of[landmark] for key in filter(is_pose, factor.keys())]
        return max(poses)

    def drop(self, landmarks: Iterable[int]) -> list[int]:
        """Forget landmarks; the slots of their factors."""
        return [slot for landmark in landmarks for slot, _ in self._of.pop(landmark)]

    def marginalize(self, landmarks: list[int], estimate: Estimate) -> tuple[gtsam.NonlinearFactorGraph, list[int]]:
        """One factor in place of all factors of some landmarks, and the slots of these.

        Landmarks that are not determined are left as they are, such as those seen in a path that was mostly guessed.
        """
        finite = [landmark for landmark in landmarks if np.isfinite(estimate.point(landmark)).all()]
        marginal = self._marginal_of(finite, estimate)
        if weak := marginal.undetermined:
            marginal = self._marginal_of([landmark for landmark in finite if landmark not in weak], estimate)
        added = gtsam.NonlinearFactorGraph()
        if marginal.landmarks:
            self._marginals.append(marginal)
            added.add(marginal.factor)
        return added, self.drop(marginal.landmarks)

    def _marginal_of(self, landmarks: list[int], estimate: Estimate) -> LandmarkMarginal:
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if estimate.has(CALIBRATION):
            values.insert(CALIBRATION, estimate.calibration())
        for landmark in landmarks:
            values.insert(landmark, estimate.point(landmark))
            for _, factor in self._of[landmark]:
                factors.add(factor)
                for pose in filter(is_pose, factor.keys()):
                    if not values.exists(pose):
                        values.insert(pose, estimate.pose(pose))
        return LandmarkMarginal(factors, landmarks, values)

    def insert_marginalized(self, values: gtsam.Values) -> None:
        """Add landmarks that were marginalized to values of the poses."""
        for marginal in self._marginals:
            marginal.insert_landmarks(values)


def astray(factors: gtsam.NonlinearFactorGraph, estimate: gtsam.Values) -> set[int]:
    """Landmarks that cannot be where they are estimated: not in front of all cameras that saw them."""
    found = set()
    for slot in range(factors.size()):
        factor = factors.at(slot)
        if isinstance(factor, gtsam.GeneralSFMFactor2Cal3Bundler):
            pose, landmark, _ = factor.keys()
            if not MIN_DEPTH < estimate.atPose3(pose).transformTo(estimate.atPoint3(landmark))[2] < MAX_DISTANCE:
                found.add(landmark)
    return found
