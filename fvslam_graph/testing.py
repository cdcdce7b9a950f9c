"""Worlds with exact ground truth and assertions for pytest, so that any estimator or fusion rule can be tested.

Say `pytest_plugins = ["fvslam_graph.testing"]` in a conftest.py, and tests can ask for `uav_sequence` (a downward
camera over terrain, 640x480) and `drive_sequence` (a camera on a road between facades, 621x188). Where pytest is not
installed, the functions are there all the same.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

from fvslam_graph.api import evaluate
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.metrics import Evaluation
from fvslam_graph.evaluation.monte_carlo import rule_consistency
from fvslam_graph.evaluation.nees import Consistency
from fvslam_graph.fusion.rules import FusionRule
from fvslam_graph.runs.results import Run
from fvslam_graph.simulation.synthetic import synthetic_sequence


def rendered(world: str, **options: Any) -> Sequence:
    """A synthetic world with all its images in memory; world and options as for `synthetic_sequence`."""
    sequence = synthetic_sequence(world, **options)
    images = [sequence.load(index) for index in range(len(sequence))]
    return replace(sequence, load=images.__getitem__)


def assert_ape_below(
    estimated: Run | Trajectory,
    limit: float,
    reference: Trajectory | None = None,
    align: str = "se3",
    coverage: float = 1.0,
) -> Evaluation:
    """Assert that the absolute pose error is small enough, for as many frames as there should be.

    Args:
        estimated: A run, which knows its ground truth, or a trajectory.
        limit: Metres, RMSE of the translation after alignment.
        reference: Ground truth, for a trajectory.
        align: "none", "origin", "se3" or "sim3".
        coverage: Least share of the poses of the ground truth that the estimate has.

    Returns:
        All the other errors.

    Raises:
        AssertionError: Says what was measured.
    """
    __tracebackhide__ = True
    evaluation = evaluate(estimated, reference, align)
    truth = reference or (estimated.ground_truth if isinstance(estimated, Run) else None)
    poses, frames = len(evaluation.pairs.indices), len(truth) if truth else 0
    assert poses >= coverage * frames, f"{poses} of {frames} frames have a pose, fewer than {100 * coverage:g} %"
    error = evaluation.errors["ape_trans"].stats["rmse"]
    assert error < limit, f"APE {error:.4g} m (RMSE, {align} alignment) is not below {limit:g} m"
    return evaluation


def assert_rule_is_consistent(rule: FusionRule, seeds: int = 10, frames: int = 22, level: float = 0.999) -> Consistency:
    """Assert that a fusion rule is about as wrong as its covariance says, over Monte-Carlo runs on simulated points.

    Each run is a drive of its own; at every fifth frame, the rule fuses the motions of odometry and of visual SLAM,
    which see the same pixels. The NEES of a fused motion has six degrees of freedom. Over 40 runs, its mean is 5.2 for
    the weighted mean, 6.0 for covariance intersection, and 10.9 where both motions are taken as independent.

    Args:
        rule: Called with two `GaussianPose`s.
        seeds: How many runs, of a second or so.
        frames: Of each.
        level: Probability with which a consistent rule lies in the chi-square band.

    Returns:
        What was measured.

    Raises:
        AssertionError: The mean NEES is outside the band: the rule is overconfident, or needlessly cautious.
    """
    __tracebackhide__ = True
    found = rule_consistency(rule, seeds, frames, level)
    said = f"mean NEES {found.mean:.2f} of {found.count} motions is not between {found.low:.2f} and {found.high:.2f}"
    assert found.mean <= found.high, f"the rule is overconfident: {said}"
    assert found.mean >= found.low, f"the rule is needlessly cautious: {said}"
    return found


with suppress(ImportError):
    import pytest

    @pytest.fixture(scope="session")
    def uav_sequence() -> Sequence:
        """40 frames of a small UAV above terrain, 49 m."""
        return rendered("uav", frames=40)

    @pytest.fixture(scope="session")
    def drive_sequence() -> Sequence:
        """40 frames of a car on a road, 40 m."""
        return rendered("drive", frames=40, size="621x188")
