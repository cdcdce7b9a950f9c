"""What landmarks that are out of sight said of the poses that saw them, in one factor."""

from __future__ import annotations

import gtsam
import numpy as np

from fvslam_graph.fusion.calibration import CALIBRATION

FARTHEST = 1e6  # metres; a landmark known less well than that is not determined


class Summary:
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
        return [landmark for landmark, sharp in zip(self.landmarks, sharpness, strict=True) if not sharp > 1 / FARTHEST]

    def insert_landmarks(self, values: gtsam.Values) -> None:
        """Add the landmarks to values of the poses, where they are most likely for these."""
        moved = gtsam.VectorValues()
        for key in self.factor.keys():  # noqa: SIM118
            at = gtsam.Values.atCal3Bundler if key == CALIBRATION else gtsam.Values.atPose3
            moved.insert(key, at(self._estimate, key).localCoordinates(at(values, key)))
        found = self._estimate.retract(self._by_poses.solve(moved))
        for landmark in self.landmarks:
            values.insert(landmark, found.atPoint3(landmark))
