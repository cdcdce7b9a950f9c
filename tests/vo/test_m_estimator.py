"""Covariance of M-estimates."""

import numpy as np
import pytest

from fvslam_graph.vo.m_estimator import clustered, m_estimator_covariance


def covariance_of(residual, jacobian, loss_scale, clusters):
    """The covariance by measurements of one residual each."""
    return m_estimator_covariance(residual[:, None], jacobian[:, None], loss_scale, clusters)


def test_covariance_of_least_squares():
    """It is that of ordinary least squares with the noise of the residuals themselves, where the loss is wide."""
    rng = np.random.default_rng(0)
    jacobian = rng.standard_normal((20_000, 3)) * (1.0, 2.0, 5.0)
    covariance = covariance_of(0.5 * rng.standard_normal(20_000), jacobian, 1e3, np.arange(20_000))
    assert covariance == pytest.approx(0.25 * np.linalg.inv(jacobian.T @ jacobian), rel=0.05, abs=1e-7)


def test_residuals_that_are_alike_count_as_one():
    """Each five times over: the covariance stays what it was, where it is known which are the same."""
    rng = np.random.default_rng(0)
    jacobian, residual = rng.standard_normal((2_000, 3)), 0.5 * rng.standard_normal(2_000)
    once = covariance_of(residual, jacobian, 1e3, np.arange(2_000))
    five = [np.repeat(array, 5, axis=0) for array in (residual, jacobian, np.arange(2_000))]
    assert covariance_of(five[0], five[1], 1e3, five[2]) == pytest.approx(once, rel=1e-9, abs=1e-12)
    assert covariance_of(five[0], five[1], 1e3, np.arange(10_000)) == pytest.approx(once / 5, rel=0.01, abs=1e-6)
    assert clustered(np.array([[1.0], [2.0], [4.0]]), np.array([7, 3, 7])).tolist() == [[2.0], [5.0]]


def test_residuals_that_determine_nothing_have_no_covariance():
    rng = np.random.default_rng(0)
    jacobian, residual, each = rng.standard_normal((20, 3)), 0.1 * rng.standard_normal(20), np.arange(20)
    assert covariance_of(residual, jacobian, 0.3, each) is not None
    assert covariance_of(residual[:3], jacobian[:3], 0.3, each[:3]) is None
    assert covariance_of(residual, jacobian[:, [0, 1, 1]], 0.3, each) is None
    outliers = covariance_of(residual + 10, jacobian, 0.3, each)
    assert np.linalg.eigvalsh(outliers)[0] > 100  # of all that agree, a few hundredths
