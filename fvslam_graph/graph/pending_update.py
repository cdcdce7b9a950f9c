"""The next update of the solver, as it is collected."""

from __future__ import annotations

from typing import Any

import gtsam

from fvslam_graph.graph.calibration import CALIBRATION
from fvslam_graph.graph.solver import Solver


class PendingUpdate:
    """Collects factors and variables until the graph is solved.

    Attributes:
        solver: Takes them in.
        factors: New ones.
        values: First values of new variables.
        stamps: When variables are seen, seconds.
    """

    def __init__(self, solver: Solver) -> None:
        self.solver = solver
        self._clear()

    def add(self, factor: gtsam.NonlinearFactor) -> None:
        """Add a factor."""
        self.factors.add(factor)

    def insert(self, key: int, value: Any) -> None:
        """Add the first value of a variable."""
        self.values.insert(key, value)

    def has(self, key: int) -> bool:
        """Whether a variable is in the graph, or about to enter it."""
        return bool(self.values.exists(key) or self.solver.has(key))

    def linearised(self, key: int) -> gtsam.Pose3:
        """The pose where the factors of a variable are linearised.

        New variables begin relative to it, not to the estimate: until it is linearised again, the path may have moved
        by more than the step that is added to it.
        """
        return self.values.atPose3(key) if self.values.exists(key) else self.solver.linearised(key)

    def calibration(self) -> gtsam.Cal3Bundler:
        """The camera's calibration as known now."""
        return self.solver.calibration() if self.solver.has(CALIBRATION) else self.values.atCal3Bundler(CALIBRATION)

    def solve(self) -> None:
        """Hand all to the solver, once, also where it cannot be solved."""
        batch = self.factors, self.values, self.stamps
        self._clear()
        self.solver.update(*batch)

    def _clear(self) -> None:
        self.factors, self.values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self.stamps: dict[int, float] = {}
