"""Sparse Jacobians, and covariances that grow and shrink."""

import numpy as np

from fvslam_graph.slam.covariances import (
    each_transformed,
    extended,
    innovation_covariance,
    selected,
    sparse_rows,
    transformed,
)

from .conftest import random_covariance


def test_sparse_rows():
    blocks = np.arange(12.0).reshape(2, 2, 3)
    dense = sparse_rows(
        [(blocks, np.array([[0, 2, 4], [1, 2, 3]])), (np.ones((1, 1, 1)), np.array([[4]]))], 5
    ).toarray()
    assert dense.tolist() == [[0, 0, 1, 0, 2], [3, 0, 4, 0, 5], [0, 6, 7, 8, 0], [0, 9, 10, 11, 0], [0, 0, 0, 0, 1]]


def test_transformed_is_symmetric_to_the_bit():
    rng = np.random.default_rng(0)
    covariance = random_covariance(rng, 7, 1.0)
    jacobian = sparse_rows(
        [(rng.standard_normal((3, 2, 4)), rng.permuted(np.tile(np.arange(7), (3, 1)), axis=1)[:, :4])], 7
    )
    result = transformed(covariance, jacobian)
    assert np.array_equal(result, result.T)
    assert np.allclose(result, jacobian.toarray() @ covariance @ jacobian.toarray().T)


def test_each_transformed_is_what_the_whole_has_on_its_diagonal():
    rng = np.random.default_rng(3)
    covariance = random_covariance(rng, 7, 1.0)
    blocks, columns = rng.standard_normal((3, 2, 4)), rng.permuted(np.tile(np.arange(7), (3, 1)), axis=1)[:, :4]
    whole = transformed(covariance, sparse_rows([(blocks, columns)], 7))
    each = each_transformed(covariance, blocks, columns)
    assert np.allclose(each, [whole[:2, :2], whole[2:4, 2:4], whole[4:, 4:]])


def test_innovation_is_that_of_dense_matrices():
    rng = np.random.default_rng(2)
    covariance = random_covariance(rng, 5, 1.0)
    jacobian = sparse_rows([(rng.standard_normal((2, 2, 3)), np.array([[0, 1, 2], [0, 3, 4]]))], 5)
    product, spread = innovation_covariance(jacobian, covariance, 0.5)
    dense = jacobian.toarray()
    assert np.allclose(product, dense @ covariance)
    assert np.allclose(spread, dense @ covariance @ dense.T + 0.25 * np.eye(4))
    assert np.array_equal(spread, spread.T)


def test_what_is_put_at_the_end_can_be_taken_from_anywhere():
    rng = np.random.default_rng(1)
    whole = random_covariance(rng, 6, 1.0)
    grown = extended(whole[:4, :4], whole[4:, :4], whole[4:, 4:])
    assert np.array_equal(grown, whole)
    order = np.array([4, 0, 5, 1])
    assert np.array_equal(selected(grown, order), whole[np.ix_(order, order)])
    rows = np.array([True, False, True, True, False, True])
    assert np.array_equal(selected(grown, rows), whole[np.ix_(rows, rows)])
