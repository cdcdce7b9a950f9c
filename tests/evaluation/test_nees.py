import gtsam
import numpy as np
import pytest

from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.association import associate
from fvslam_graph.evaluation.nees import average_nees, consistency, nees, nees_band, relative_errors
from fvslam_graph.runs.results import Relatives


def covariance(rng: np.random.Generator) -> np.ndarray:
    """Of a plausible step: 0.01 deg, some mm across and some cm along the direction of travel, all correlated."""
    mixing = rng.standard_normal((6, 6)) * np.array([2e-4, 2e-4, 2e-4, 3e-3, 3e-3, 3e-2])[:, None]
    return mixing @ mixing.T


def test_full_rank_is_the_mahalanobis_distance() -> None:
    rng = np.random.default_rng(0)
    covariances = np.array([covariance(rng) for _ in range(50)])
    errors = np.array([rng.multivariate_normal(np.zeros(6), P) for P in covariances])
    values, dof = nees(errors, covariances)
    expected = [e @ np.linalg.solve(P, e) for e, P in zip(errors, covariances, strict=True)]
    assert np.allclose(values, expected, rtol=1e-6)
    assert (dof == 6).all()


def test_a_direction_without_variance_is_left_out() -> None:
    rng = np.random.default_rng(1)
    travel = np.array([0.6, 0.0, 0.8])
    across = np.eye(6)
    across[3:, 3:] -= np.outer(travel, travel)
    covariances = np.array([across @ covariance(rng) @ across.T])
    error = across @ (1e-3 * rng.standard_normal(6))
    along = np.concatenate([np.zeros(3), travel])
    values, dof = nees(np.array([error, error + 5.0 * along]), covariances[[0, 0]])
    assert dof.tolist() == [5, 5]
    assert values[0] > 0.1
    assert values[1] == pytest.approx(values[0], rel=1e-6)


def test_the_band_is_that_of_the_textbook() -> None:
    # Bar-Shalom et al., section 5.4.2: 50 runs of a state of 2 have [1.5, 2.6], from chi-square with 100 dof.
    assert nees_band(2, 50) == pytest.approx((74.22 / 50, 129.56 / 50), abs=1e-3)
    low, high = nees_band(6, 1000, 0.99)
    assert low < nees_band(6, 1000)[0] < 6 < nees_band(6, 1000)[1] < high


def test_honest_covariances_are_consistent_and_others_are_not() -> None:
    rng = np.random.default_rng(2)
    covariances = np.array([covariance(rng) for _ in range(2000)])
    errors = np.array([rng.multivariate_normal(np.zeros(6), P) for P in covariances])
    consistent = consistency(errors, covariances)
    assert (consistent.count, consistent.dof) == (2000, 6)
    assert consistent.low < consistent.mean < consistent.high
    assert 0.935 < consistent.below < 0.965
    assert consistency(1.2 * errors, covariances).mean > consistent.high
    assert consistency(0.8 * errors, covariances).mean < consistent.low


def test_monte_carlo_average_over_runs() -> None:
    runs = np.random.default_rng(3).chisquare(6, (40, 300))
    mean, (low, high) = average_nees(runs)
    assert mean.shape == (300,)
    assert (low, high) == nees_band(6, 40)
    assert 0.92 < np.mean((low < mean) & (mean < high)) < 0.98


def test_relative_errors_are_the_perturbations() -> None:
    rng = np.random.default_rng(4)
    step = gtsam.Pose3(gtsam.Rot3.Ry(0.05), np.array([0.1, 0.0, 1.0]))
    perturbations = 0.01 * rng.standard_normal((6, 6))
    world = gtsam.Pose3(gtsam.Rot3.Rx(1.0), np.array([5.0, 6.0, 7.0]))
    poses = [world]
    for _ in range(5):
        poses.append(poses[-1] * step)
    reference = Trajectory(np.arange(6.0), tuple(poses))
    estimate = reference.from_origin()
    half = gtsam.Pose3(step.rotation(), 0.5 * step.translation())
    # Frame 4 was measured from frame 2, frame 5 has no covariance, and frame 1 no reference.
    previous = np.array([0, 0, 1, 2, 2, 4])
    motions = [half] * 4 + [estimate.poses[2].between(estimate.poses[4]), half]
    motions[4] = gtsam.Pose3(motions[4].rotation(), 0.5 * motions[4].translation())
    exact = [gtsam.Pose3(motion.rotation(), 2.0 * motion.translation()) for motion in motions]
    noisy = [motion * gtsam.Pose3.Expmap(-e) for motion, e in zip(exact, perturbations, strict=True)]
    matrices = np.array([motion.matrix() for motion in noisy])
    matrices[:, :3, 3] /= 2
    covariances = np.tile(np.eye(6), (6, 1, 1))
    covariances[[0, 5]] = np.nan
    kept = [0, 2, 3, 4, 5]
    known = Trajectory(reference.stamps[kept], tuple(reference.poses[i] for i in kept))

    found = relative_errors(associate(estimate, known), Relatives(previous, matrices, covariances), scale=2.0)
    assert np.allclose(found.errors, perturbations[[3, 4]], atol=1e-9)
    assert np.array_equal(found.covariances, np.tile(np.diag([1.0, 1.0, 1.0, 4.0, 4.0, 4.0]), (2, 1, 1)))
