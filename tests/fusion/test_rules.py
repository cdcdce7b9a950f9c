"""Fusion rules: the mean, and that it is what a factor graph makes of two priors; covariance intersection."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.fusion.rules import Average, Intersection

WEIGHTS = (0.0, 0.2, 0.5, 0.9, 1.0)


def covariance(rng: np.random.Generator, size: float = 0.1) -> np.ndarray:
    mixing = size * rng.standard_normal((6, 6))
    return mixing @ mixing.T


def pair(seed: int, apart: float = 0.3) -> tuple[GaussianPose, GaussianPose]:
    rng = np.random.default_rng(seed)
    first = gtsam.Pose3.Expmap(rng.standard_normal(6))
    second = first.retract(apart * rng.standard_normal(6))
    return GaussianPose(first, covariance(rng)), GaussianPose(second, covariance(rng))


def maximum_a_posteriori(graph: gtsam.NonlinearFactorGraph, start: gtsam.Pose3) -> gtsam.Pose3:
    values = gtsam.Values()
    values.insert(0, start)
    parameters = gtsam.GaussNewtonParams()
    parameters.setRelativeErrorTol(0.0)
    parameters.setAbsoluteErrorTol(0.0)
    parameters.setMaxIterations(100)
    return gtsam.GaussNewtonOptimizer(graph, values, parameters).optimize().atPose3(0)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("weight", WEIGHTS)
def test_average_is_the_map_of_two_priors_each_on_rotation_and_translation(seed, weight):
    odometry, slam = pair(seed)
    graph = gtsam.NonlinearFactorGraph()
    for pose, information in ((odometry.mean, 1 - weight), (slam.mean, weight)):
        if information > 0:
            noise = gtsam.noiseModel.Isotropic.Precision(3, information)
            graph.add(gtsam.PoseRotationPrior3D(0, pose.rotation(), noise))
            graph.add(gtsam.PoseTranslationPrior3D(0, pose.translation(), noise))
    fused = Average(weight)(odometry, slam).mean
    best = maximum_a_posteriori(graph, odometry.mean)
    assert np.abs(best.localCoordinates(fused)).max() < 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_on_se3_they_differ_in_the_second_order(seed):
    """With one prior of six degrees of freedom each, the difference falls with the square of the distance."""
    differences = []
    for apart in (0.1, 0.05):
        odometry, slam = pair(seed, apart)
        graph = gtsam.NonlinearFactorGraph()
        for pose, weight in ((odometry.mean, 0.7), (slam.mean, 0.3)):
            graph.add(gtsam.PriorFactorPose3(0, pose, gtsam.noiseModel.Isotropic.Precision(6, weight)))
        best = maximum_a_posteriori(graph, odometry.mean)
        fused = Average(0.3, geodesic=True)(odometry, slam).mean
        differences.append(np.linalg.norm(best.localCoordinates(fused)))
    assert differences[0] > 1e-5  # rad and m; not the same
    assert differences[0] / differences[1] == pytest.approx(4, rel=0.05)


@pytest.mark.parametrize("geodesic", [False, True])
def test_the_ends_of_the_mean_are_its_parts(geodesic):
    odometry, slam = pair(0)
    for weight, part in ((0.0, odometry), (1.0, slam)):
        fused = Average(weight, geodesic)(odometry, slam)
        assert fused.mean.equals(part.mean, 1e-9)
        assert fused.covariance == pytest.approx(part.covariance)


@pytest.mark.parametrize("rule", [Average(0.5), Intersection(), Intersection("trace")])
@pytest.mark.parametrize("shared", [0.0, 0.5, 1.0])
def test_no_rule_claims_more_than_it_knows(rule, shared):
    """Errors that have a share in common: the true covariance of the result is within the one that is claimed."""
    errors, claimed, sigma = [], [], np.repeat([0.002, 0.01], 3)
    draws = np.random.default_rng(0).standard_normal((300, 18))
    draws -= draws.mean(axis=0)
    draws @= np.linalg.inv(np.linalg.cholesky(np.cov(draws.T))).T  # exactly independent
    for common, first, second in sigma * draws.reshape(-1, 3, 6):
        a = np.sqrt(shared) * common + np.sqrt(1 - shared) * first
        b = np.sqrt(shared) * common + np.sqrt(1 - shared) * second
        fused = rule(*(GaussianPose(gtsam.Pose3.Expmap(e), np.diag(sigma**2)) for e in (a, b)))
        errors.append(gtsam.Pose3.Logmap(fused.mean))
        claimed.append(fused.covariance)
    true = np.cov(np.array(errors).T) / np.outer(sigma, sigma)
    assert np.linalg.eigvalsh(np.mean(claimed, axis=0) / np.outer(sigma, sigma) - true)[0] > -0.1
    if isinstance(rule, Average):
        assert np.trace(true) / 6 == pytest.approx((1 + shared) / 2, abs=0.05)


def test_intersection_listens_to_the_one_that_knows():
    rng = np.random.default_rng(1)
    odometry, slam = pair(2, 0.05)
    certain = GaussianPose(slam.mean, 1e-6 * covariance(rng))
    fused = Intersection()(odometry, certain)
    assert fused.mean.equals(certain.mean, 1e-3)
    assert np.trace(fused.covariance) < 1.1 * np.trace(certain.covariance)


@pytest.mark.parametrize("criterion", ["determinant", "trace"])
@pytest.mark.parametrize("seed", range(5))
def test_intersection_is_no_larger_than_either(criterion, seed):
    odometry, slam = pair(seed, 0.05)
    fused = Intersection(criterion)(odometry, slam)
    determinants = [np.linalg.slogdet(pose.covariance)[1] for pose in (odometry, slam)]
    if criterion == "determinant":
        assert np.linalg.slogdet(fused.covariance)[1] <= min(determinants) + 1e-6
    assert np.array_equal(fused.covariance, fused.covariance.T)
    assert np.linalg.eigvalsh(fused.covariance)[0] > 0


def test_equal_estimates_are_left_as_they_are():
    odometry, _ = pair(3)
    for rule in (Average(0.5), Intersection(), Intersection("trace")):
        fused = rule(odometry, odometry)
        assert fused.mean.equals(odometry.mean, 1e-9)
        assert fused.covariance == pytest.approx(odometry.covariance, rel=1e-6, abs=1e-9)
