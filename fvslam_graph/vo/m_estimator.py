"""Covariance of what minimises a Cauchy loss, from the residuals themselves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera

NEIGHBOURHOODS = (8, 6)  # of the image, within which tracks have a common error: blur, rolling shutter, calibration
MIN_CURVATURE = 0.1  # of a loss, as a share of what least squares would have with its weights


def neighbourhoods(pixels: NDArray[np.float64], camera: Camera) -> NDArray[np.intp]:
    """Numbers (N,) of the cells of the image that points (N, 2) lie in."""
    cells = (
        (pixels * np.divide(NEIGHBOURHOODS, (camera.width, camera.height)))
        .astype(np.intp)
        .clip(0, np.subtract(NEIGHBOURHOODS, 1))
    )
    return np.asarray(cells[:, 1] * NEIGHBOURHOODS[0] + cells[:, 0])


def clustered(scores: NDArray[np.float64], clusters: NDArray[np.intp]) -> NDArray[np.float64]:
    """Scores (N, P) of residuals summed over each of C clusters, (C, P)."""
    member = np.zeros((int(clusters.max(initial=0)) + 1, len(scores)))
    member[clusters, np.arange(len(scores))] = 1.0
    return member[member.any(axis=1)] @ scores


def m_estimator_covariance(
    residual: NDArray[np.float64],
    jacobian: NDArray[np.float64],
    loss_scale: float,
    clusters: NDArray[np.intp] | None = None,
    prior: NDArray[np.float64] | None = None,
) -> NDArray[np.float64] | None:
    """Covariance of an M-estimate with a Cauchy loss, by the residuals themselves: no noise level is assumed.

    Args:
        residual: (N, R) at the estimate, of each of N measurements.
        jacobian: (N, R, P) of the residuals.
        loss_scale: Of the loss of a measurement, in the residuals' unit.
        clusters: (N,) numbers of groups of measurements, which are independent of other groups and need not be within;
            None where all are independent.
        prior: (P, P) information that there is besides the residuals.

    Returns:
        (P, P); None where the residuals do not determine the parameters.

    Source: Huber, Robust Statistics, section 6.3; Liang and Zeger 1986 (clusters).
    """
    weight = 1 / (1 + np.vecdot(residual, residual) / loss_scale**2)
    weighted = weight[:, None, None] * jacobian
    information = np.einsum("nri,nrj->ij", weighted, jacobian)
    gradients = (weighted * residual[:, :, None]).sum(axis=1)
    scores = gradients if clusters is None else clustered(gradients, clusters)
    count, parameters = len(scores), float(jacobian.shape[2])
    if prior is not None:
        parameters = float(np.trace(np.linalg.solve(information + prior, information)))  # as far as residuals tell them
        information = information + prior
    values = np.linalg.eigvalsh(information)
    if count <= parameters or not values[0] > 1e-12 * values[-1]:
        return None
    # The loss bends away from least squares with its weights. Where few residuals tell something and these are large,
    # more than all of its curvature could be gone: a tenth is left.
    root = np.linalg.inv(np.linalg.cholesky(information))
    bent = 2 / loss_scale**2 * gradients.T @ gradients
    share, axes = np.linalg.eigh(root @ (information - bent) @ root.T)
    inverse = root.T @ (axes / np.maximum(share, MIN_CURVATURE)) @ axes.T @ root
    # Residuals are smaller than errors, since they were minimised; and a sum of so few squares is now and then too
    # small by far (Hotelling 1931).
    small_sample = count / (count - parameters) * (count - 1) / max(count - parameters - 2, 1)
    meat = small_sample * scores.T @ scores
    if prior is not None:
        meat += prior
    covariance: NDArray[np.float64] = inverse @ meat @ inverse
    return (covariance + covariance.T) / 2
