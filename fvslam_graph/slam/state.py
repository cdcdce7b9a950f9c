"""The state of the filter: camera pose, velocity and landmarks, all expressed in the present camera."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import cv2
import gtsam
import numpy as np
import scipy.linalg
import scipy.sparse
from numpy.typing import NDArray

from fvslam_graph.slam.landmarks import INVERSE, POINT, Array, to_points

POSE, SCALE, VELOCITY, FIXED = slice(0, 6), 6, slice(7, 13), 13  # rows of the error state before the landmarks
_GROWTH = np.array([1, 1, 1, 0, 0, -1])  # of a landmark in inverse depth, with the scale
LEAST_LOG_VARIANCE = 1e-6  # of a log distance, so that no landmark stands for the whole map
SLACK = 1e-9  # of the largest eigenvalue, that rounding may take from a positive semi-definite matrix


@dataclass(frozen=True)
class State:
    """The estimate of a camera-centred EKF.

    Source: Castellanos, Martinez-Cantin, Tardos, Neira, "Robocentric map joining", RAS 55(1), 2007.

    The error state is the right perturbation of the pose (6), the logarithm of the scale (1), the error of the velocity
    (6) and those of the landmarks: first all in inverse depth (6 each), then all points (3 each). The pose's error is
    thus one of the world as seen from the camera.

    Velocity and landmarks are known up to a scale, which images tell nothing about. It has a row of its own, whose
    Jacobian in every image measurement is zero, wherever that is linearised. Were it hidden in the other rows, each
    new linearisation would seem to observe a little of it, and the filter would be sure of a scale that drifts.

    Attributes:
        world_T_camera: Camera pose, metres.
        velocity: (6,) mean twist of the last step in the camera: rotation (rad/s), translation (m/s).
        inverse: (M, 6) landmarks in inverse depth, see `landmarks`.
        points: (L, 3) landmarks as points in the camera, metres.
        ids: (M + L,) of all landmarks, in the order of the state.
        covariance: (n, n) of the error state, symmetric positive semi-definite.
    """

    world_T_camera: gtsam.Pose3
    velocity: Array
    inverse: Array
    points: Array
    ids: NDArray[np.int64]
    covariance: Array

    def __post_init__(self) -> None:
        if sys.flags.dev_mode:  # python -X dev
            self.check()

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def at(cls, world_T_camera: gtsam.Pose3, covariance: Array) -> Self:
        """A camera with an empty map and no velocity, at a pose with covariance (6, 6)."""
        whole = scipy.linalg.block_diag(covariance, np.zeros((FIXED - 6, FIXED - 6)))
        none = np.empty(0, np.int64)
        return cls(world_T_camera, np.zeros(6), np.empty((0, INVERSE)), np.empty((0, POINT)), none, whole)

    @cached_property
    def offsets(self) -> NDArray[np.intp]:
        """(M + L,) row of the error state at which each landmark begins."""
        begin = FIXED + INVERSE * len(self.inverse)
        return np.concatenate(
            [FIXED + INVERSE * np.arange(len(self.inverse)), begin + POINT * np.arange(len(self.points))]
        ).astype(np.intp)

    @cached_property
    def columns(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """What the view of each landmark depends on, the velocity and itself: columns (M, 12) and (L, 9)."""
        split, offsets = len(self.inverse), self.offsets
        first, second = (
            np.hstack([np.tile(np.arange(FIXED)[VELOCITY], (len(begin), 1)), begin[:, None] + np.arange(size)])
            for begin, size in ((offsets[:split], INVERSE), (offsets[split:], POINT))
        )
        return first, second

    @cached_property
    def positions(self) -> Array:
        """Landmarks (M + L, 3) as points in the camera, metres."""
        return np.vstack([self._inverse_as_points[0], self.points])

    @cached_property
    def _inverse_as_points(self) -> tuple[Array, Array]:
        return to_points(self.inverse)

    def position_covariances(self) -> Array:
        """Of the landmarks as points, with what is uncertain of their scale; (M + L, 3, 3)."""
        points, by_inverse = self._inverse_as_points
        groups = []
        for point, by_landmark, columns in (
            (points, by_inverse, self.columns[0]),
            (self.points, np.broadcast_to(np.eye(POINT), (len(self.points), POINT, POINT)), self.columns[1]),
        ):
            jacobian = np.concatenate([point[:, :, None], by_landmark], axis=2)
            rows = np.hstack([np.full((len(point), 1), SCALE), columns[:, 6:]])
            groups.append(jacobian @ self.covariance[rows[:, :, None], rows[:, None, :]] @ jacobian.mT)
        return np.concatenate(groups)

    def landmark_covariances(self) -> tuple[Array, Array]:
        """Those of the landmarks in inverse depth (M, 6, 6) and of the points (L, 3, 3)."""
        first, second = (columns[:, 6:] for columns in self.columns)
        covariance = self.covariance
        return covariance[first[:, :, None], first[:, None, :]], covariance[second[:, :, None], second[:, None, :]]

    @property
    def by_scale(self) -> Array:
        """(n,) how velocity and landmarks grow with the logarithm of their scale; zero for the pose."""
        inverse = self.inverse * _GROWTH
        velocity = self.velocity * (0, 0, 0, 1, 1, 1)
        return np.concatenate([np.zeros(7), velocity, inverse.ravel(), self.points.ravel()])

    def moved(self, error: Array) -> State:
        """The state changed by an error state (n,); the covariance stays."""
        split, growth = FIXED + self.inverse.size, np.exp(error[SCALE])
        return replace(
            self,
            world_T_camera=self.world_T_camera.retract(error[POSE]),
            velocity=(self.velocity + error[VELOCITY]) * np.repeat([1.0, growth], 3),
            inverse=(self.inverse + error[FIXED:split].reshape(-1, INVERSE)) * growth**_GROWTH,
            points=(self.points + error[split:].reshape(-1, POINT)) * growth,
        )

    def with_scale_apart(self) -> State:
        """The same state with what is uncertain of the map's scale moved into the row of the scale.

        The scale of the map is taken as the weighted mean of the logarithms of all distances. As the growth of
        everything with the scale is the same, whatever row it is counted in, no estimate and no uncertainty of metric
        quantities changes.
        """
        weight = self._mean_log_distance()
        if weight is None:
            return self
        # error' = T error: the scale takes over the mean, and everything else gives it up.
        growth = self.by_scale
        growth[SCALE] = -1.0
        column = self.covariance @ weight
        change = np.outer(growth, column - 0.5 * (weight @ column) * growth)
        change += cv2.transpose(change)
        np.subtract(self.covariance, change, out=change)
        return replace(self, covariance=change)

    def without(self, dropped: NDArray[np.bool_]) -> State:
        """The state without the landmarks that are marked, (M + L,)."""
        if not dropped.any():
            return self
        split, kept = len(self.inverse), ~dropped
        sizes = np.repeat((INVERSE, POINT), (split, len(self.points)))
        rows = np.concatenate([np.ones(FIXED, bool), np.repeat(kept, sizes)])
        return replace(
            self,
            inverse=self.inverse[kept[:split]],
            points=self.points[kept[split:]],
            ids=self.ids[kept],
            covariance=self.covariance[np.ix_(rows, rows)],
        )

    def with_points(self, chosen: NDArray[np.bool_]) -> State:
        """The state in which the marked landmarks, (M,) of those in inverse depth, are points; they move to the end."""
        if not chosen.any():
            return self
        split = len(self.inverse)
        points, jacobian = to_points(self.inverse[chosen])
        columns = self.columns[0][chosen, 6:]
        stay = np.setdiff1d(np.arange(len(self.covariance)), columns.ravel())
        change = sparse_rows(
            [(np.ones((len(stay), 1, 1)), stay[:, None]), (jacobian, columns)], width=len(self.covariance)
        )
        return replace(
            self,
            inverse=self.inverse[~chosen],
            points=np.vstack([self.points, points]),
            ids=np.concatenate([self.ids[:split][~chosen], self.ids[split:], self.ids[:split][chosen]]),
            covariance=transformed(self.covariance, change),
        )

    def log_distances(self) -> tuple[NDArray[np.bool_], Array, tuple[Array, Array]]:
        """Of landmarks in front of the camera: which (N,) these are, all log distances (N,) and their Jacobians.

        The Jacobians are by the landmarks themselves, (M, 6) and (L, 3).
        """
        points, split = self.positions, len(self.inverse)
        front = points[:, 2] > 0
        front[:split] &= self.inverse[:, 5] > 0
        square = np.maximum((points**2).sum(axis=1), 1e-18)
        by_point = points / square[:, None]
        by_inverse = np.einsum("ni,nij->nj", by_point[:split], self._inverse_as_points[1])
        return front, 0.5 * np.log(square), (by_inverse, by_point[split:])

    def _mean_log_distance(self) -> Array | None:
        """(n,) Jacobian of the mean log distance, in which the certain ones weigh most; None without landmarks."""
        front, _, jacobians = self.log_distances()
        if not front.any():
            return None
        variances = [
            np.einsum("ni,nij,nj->n", jacobian, covariance, jacobian)
            for jacobian, covariance in zip(jacobians, self.landmark_covariances(), strict=True)
        ]
        weight = front / (np.concatenate(variances) + LEAST_LOG_VARIANCE)
        weight /= weight.sum()
        mean = np.zeros(len(self.covariance))
        for jacobian, columns, part in zip(jacobians, self.columns, np.split(weight, [len(self.inverse)]), strict=True):
            mean[columns[:, 6:]] = part[:, None] * jacobian
        return mean

    def check(self) -> None:
        """Raise an AssertionError unless the covariance is finite, symmetric and positive semi-definite."""
        assert np.isfinite(self.covariance).all(), "the covariance is not finite"
        assert np.array_equal(self.covariance, self.covariance.T), "the covariance is not symmetric"
        # Radians and metres, near and far landmarks are made comparable first.
        sigma = np.sqrt(np.abs(np.diagonal(self.covariance)))
        sigma = np.where(sigma > 0, sigma, 1.0)
        values = np.linalg.eigvalsh(self.covariance / np.outer(sigma, sigma))
        assert values[0] >= -SLACK * values[-1], f"the covariance has the eigenvalue {values[0]:g} of {values[-1]:g}"


def sparse_rows(blocks: list[tuple[Array, NDArray[np.intp]]], width: int) -> scipy.sparse.csr_array:
    """A sparse matrix from dense blocks, one below the other.

    Args:
        blocks: (N, r, c) values and (N, c) their columns, the same for the r rows of a block.
        width: Of the matrix.
    """
    columns = [np.repeat(where, block.shape[1], axis=0).ravel() for block, where in blocks]
    lengths = [np.full(block.shape[0] * block.shape[1], block.shape[2]) for block, _ in blocks]
    starts = np.concatenate([[0], np.cumsum(np.concatenate(lengths))])
    data = np.concatenate([block.ravel() for block, _ in blocks])
    return scipy.sparse.csr_array((data, np.concatenate(columns), starts), shape=(len(starts) - 1, width))


def transformed(covariance: Array, jacobian: scipy.sparse.csr_array) -> Array:
    """J P J^T, exactly symmetric."""
    return symmetric(jacobian @ cv2.transpose(jacobian @ covariance))


def symmetric(matrix: Array) -> Array:
    """The symmetric part of a matrix; OpenCV transposes large ones in blocks, several times faster than NumPy."""
    mean: Array = cv2.transpose(matrix)
    mean += matrix
    mean *= 0.5
    return mean
