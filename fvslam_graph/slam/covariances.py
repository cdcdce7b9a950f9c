"""Operations on large covariance matrices, of which new memory and transposes cost more than the arithmetic.

SciPy is imported where it computes: it takes as long to load as NumPy and GTSAM together, and odometry does without it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.slam.inverse_depth import Array

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def keep_memory() -> None:
    """Make glibc keep up to 60 MB that is freed, for the matrices of the next frame.

    By itself it gives large blocks back to the system and asks for them anew, page by page, which takes longer than the
    arithmetic. It learns from the largest block that was ever freed (mallopt(3), M_MMAP_THRESHOLD); this one is not
    touched, and thus costs nothing. Other allocators do as they like.
    """
    np.empty(30 << 20, np.uint8)


def sparse_rows(blocks: list[tuple[Array, NDArray[np.intp]]], width: int) -> csr_array:
    """A sparse matrix from dense blocks, one below the other.

    Args:
        blocks: (N, r, c) values and (N, c) their columns, the same for the r rows of a block.
        width: Of the matrix.
    """
    from scipy.sparse import csr_array

    columns = [np.repeat(where, block.shape[1], axis=0).ravel() for block, where in blocks]
    lengths = [np.full(block.shape[0] * block.shape[1], block.shape[2]) for block, _ in blocks]
    starts = np.concatenate([[0], np.cumsum(np.concatenate(lengths))])
    data = np.concatenate([block.ravel() for block, _ in blocks])
    return csr_array((data, np.concatenate(columns), starts), shape=(len(starts) - 1, width))


def each_transformed(covariance: Array, jacobian: Array, columns: NDArray[np.intp]) -> Array:
    """The (N, r, r) J P J^T of each block of r rows on its own: values (N, r, c) and (N, c) their columns."""
    P_new: Array = jacobian @ covariance[columns[:, :, None], columns[:, None, :]] @ jacobian.mT
    return P_new


def transformed(covariance: Array, jacobian: csr_array) -> Array:
    """J P J^T, exactly symmetric."""
    return symmetric(jacobian @ cv2.transpose(jacobian @ covariance))


def innovation_covariance(jacobian: csr_array, covariance: Array, sigma: float) -> tuple[Array, Array]:
    """H P (k, n), and the innovation covariance H P H^T (k, k), exactly symmetric, with noise of deviation `sigma`."""
    product = jacobian @ covariance
    S = symmetric(jacobian @ cv2.transpose(product))
    S.ravel()[:: len(S) + 1] += sigma**2
    return product, S


def inverse_root(covariance: Array) -> Array:
    """The lower triangular L^-1 of P = L L^T, which makes numbers of covariance P (k, k) independent, of variance 1.

    P is positive definite, as the covariance of innovations is, which holds the noise of the pixels.
    """
    from scipy.linalg import lapack

    L, _ = lapack.dpotrf(covariance, lower=1)
    inverse: Array = lapack.dtrtri(L, lower=1, overwrite_c=1)[0]
    return inverse


def extended(covariance: Array, cross: Array, P_new: Array) -> Array:
    """P with new rows and columns at the end, of covariance `P_new` (k, k), and `cross` (k, n) with what is there."""
    old = len(covariance)
    P = np.empty((old + len(P_new),) * 2)
    P[:old, :old], P[old:, :old], P[:old, old:] = covariance, cross, cross.T
    P[old:, old:] = symmetric(P_new)
    return P


def selected(covariance: Array, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Array:
    """These rows and columns of P, which is symmetric: rows are taken twice, as they lie together in memory."""
    chosen: Array = cv2.transpose(covariance[rows])[rows]
    return chosen


def symmetric(matrix: Array) -> Array:
    """The symmetric part of a matrix; OpenCV transposes large ones in blocks, several times faster than NumPy."""
    mean: Array = cv2.transpose(matrix)
    mean += matrix
    mean *= 0.5
    return mean
