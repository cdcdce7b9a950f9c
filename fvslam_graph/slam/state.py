"""The state of the filter: camera pose, velocity and landmarks, all expressed in the present camera."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import cv2
import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.slam.covariances import each_transformed, extended, selected
from fvslam_graph.slam.inverse_depth import Array, to_points

# Rows of the error state before the landmarks.
POSE, SCALE, VELOCITY, ODOMETRY, FIXED = slice(0, 6), 6, slice(7, 13), 13, 14
PART = 3  # numbers of an anchor, of a ray and of a point, in the error state
_GROWTH = np.array([0, 0, -1])  # of a ray, with the scale
MIN_LOG_VARIANCE = 1e-6  # of a log distance, so that no landmark stands for the whole map
SLACK = 1e-9  # of the largest eigenvalue, that rounding may take from a positive semi-definite matrix


@dataclass(frozen=True)
class State:
    """The estimate of a camera-centred EKF.

    Source: Castellanos, Martinez-Cantin, Tardos, Neira, "Robocentric map joining", RAS 55(1), 2007.

    The error state is the right perturbation of the pose (6), the logarithm of the scale (1), the error of the velocity
    (6), that of odometry's scale (1), and those of the anchors, the rays and the points (3 each). The pose's error is
    thus one of the world as seen from the camera. Landmarks in inverse depth that began in the same frame have their
    anchor in common.

    Velocity and landmarks are known up to a scale, which images tell nothing about. It has a row of its own, whose
    Jacobian in every image measurement is zero, wherever that is linearised. Were it hidden in the other rows, each
    new linearisation would seem to observe a little of it, and the filter would be sure of a scale that drifts.

    Odometry hands over motions and depths that err by the same scale, now and at the next step. Were they independent,
    the filter would be sure of their mean, or, where odometry's scale is doubtful, trust neither.

    Attributes:
        world_T_camera: Camera pose, metres.
        velocity: (6,) mean twist of the last step in the camera: rotation (rad/s), translation (m/s).
        anchors: (A, 3) camera centres from which landmarks in inverse depth were first seen, in the camera, metres.
        inverse_depth: (M, 3) azimuth, elevation and inverse depth of these landmarks from there, see `landmarks`.
        anchor_of: (M,) the row of each one's anchor.
        points: (L, 3) landmarks as points in the camera, metres.
        ids: (M + L,) of all landmarks, in the order of the state.
        odometry_scale: Logarithm of true over odometry's lengths.
        covariance: (n, n) of the error state, symmetric positive semi-definite.
    """

    world_T_camera: gtsam.Pose3
    velocity: Array
    anchors: Array
    inverse_depth: Array
    anchor_of: NDArray[np.intp]
    points: Array
    ids: NDArray[np.int64]
    odometry_scale: float
    covariance: Array

    def __post_init__(self) -> None:
        if sys.flags.dev_mode:  # python -X dev
            self.check()

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def at(cls, world_T_camera: gtsam.Pose3, covariance: Array) -> Self:
        """A camera with an empty map and no velocity, at a pose with covariance (6, 6)."""
        P = np.zeros((FIXED, FIXED))
        P[POSE, POSE] = covariance
        none = np.empty((0, PART))
        ids, rows = np.empty(0, np.int64), np.empty(0, np.intp)
        return cls(world_T_camera, np.zeros(6), none, none, rows, none, ids, 0.0, P)

    @cached_property
    def anchored_inverse_depth(self) -> Array:
        """(M, 6) landmarks in inverse depth, each with its anchor."""
        return np.hstack([self.anchors[self.anchor_of], self.inverse_depth])

    @cached_property
    def parts(self) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Rows of the error state of the anchors (A, 3), the rays (M, 3) and the points (L, 3)."""
        rows = np.arange(FIXED, len(self.covariance)).reshape(-1, PART)
        first, second = len(self.anchors), len(self.anchors) + len(self.inverse_depth)
        return rows[:first], rows[first:second], rows[second:]

    @cached_property
    def columns(self) -> NDArray[np.intp]:
        """(M + L, 6) rows of the error state that make up each landmark: its anchor and its ray, or its point.

        A point has no anchor. Its first three are the row of the scale, by which no Jacobian of a landmark is other
        than zero, so that all landmarks are alike.
        """
        anchors, inverse_depth, points = self.parts
        columns = np.full((len(self), 2 * PART), SCALE)
        columns[: len(inverse_depth), :PART], columns[: len(inverse_depth), PART:] = (
            anchors[self.anchor_of],
            inverse_depth,
        )
        columns[len(inverse_depth) :, PART:] = points
        return columns

    @cached_property
    def positions(self) -> Array:
        """Landmarks (M + L, 3) as points in the camera, metres."""
        return np.vstack([self._inverse_as_points[0], self.points])

    @cached_property
    def J_landmark(self) -> Array:
        """(M + L, 3, 6) Jacobian of the positions by the landmarks, see `columns`."""
        J_landmark = np.zeros((len(self), PART, 2 * PART))
        J_landmark[: len(self.inverse_depth)] = self._inverse_as_points[1]
        J_landmark[len(self.inverse_depth) :, :, PART:] = np.eye(PART)
        return J_landmark

    @cached_property
    def _inverse_as_points(self) -> tuple[Array, Array]:
        return to_points(self.anchored_inverse_depth)

    def position_covariances(self) -> Array:
        """Covariances (M + L, 3, 3) of the landmarks as points, with what is uncertain of their scale."""
        jacobian = np.concatenate([self.positions[:, :, None], self.J_landmark], axis=2)
        columns = np.hstack([np.full((len(self), 1), SCALE), self.columns])
        return each_transformed(self.covariance, jacobian, columns)

    @property
    def J_scale(self) -> Array:
        """(n,) how velocity and landmarks grow with the logarithm of their scale; zero for the pose."""
        velocity, inverse_depth = self.velocity * (0, 0, 0, 1, 1, 1), self.inverse_depth * _GROWTH
        landmarks = (self.anchors.ravel(), inverse_depth.ravel(), self.points.ravel())
        return np.concatenate([np.zeros(7), velocity, np.zeros(1), *landmarks])

    def retract(self, error: Array) -> State:
        """The state changed by an error state (n,); the covariance stays."""
        growth = np.exp(error[SCALE])
        anchors, inverse_depth, points = (error[rows] for rows in self.parts)
        return replace(
            self,
            world_T_camera=self.world_T_camera.retract(error[POSE]),
            velocity=(self.velocity + error[VELOCITY]) * np.repeat([1.0, growth], 3),
            anchors=(self.anchors + anchors) * growth,
            inverse_depth=(self.inverse_depth + inverse_depth) * growth**_GROWTH,
            points=(self.points + points) * growth,
            odometry_scale=self.odometry_scale + float(error[ODOMETRY]),
        )

    def with_scale_decoupled(self) -> State:
        """The same state with what is uncertain of the map's scale moved into the row of the scale.

        The scale of the map is taken as the weighted mean of the logarithms of all distances. As the growth of
        everything with the scale is the same, whatever row it is counted in, no estimate and no uncertainty of metric
        quantities changes.
        """
        weight = self._mean_log_distance()
        if weight is None:
            return self
        # error' = T error: the scale takes over the mean, and everything else gives it up.
        growth = self.J_scale
        growth[SCALE] = -1.0
        column = self.covariance @ weight
        change = np.outer(growth, column - 0.5 * (weight @ column) * growth)
        change += cv2.transpose(change)
        np.subtract(self.covariance, change, out=change)
        return replace(self, covariance=change)

    def without(self, dropped: NDArray[np.bool_], linear: NDArray[np.bool_]) -> State:
        """The state without some of its landmarks; some of the others become points.

        Args:
            dropped: (M + L,) which go.
            linear: (M,) which of those in inverse depth become points if they stay; they move to the end.
        """
        if not dropped.any() and not linear.any():
            return self
        kept = ~dropped
        split = len(self.inverse_depth)
        turned, staying, points = kept[:split] & linear, kept[:split] & ~linear, kept[split:]
        used = np.zeros(len(self.anchors), bool)
        used[self.anchor_of[staying]] = True
        rows = np.concatenate([np.ones(FIXED, bool), np.repeat(np.concatenate([used, staying, points]), PART)])
        new, J_inverse = (part[turned] for part in self._inverse_as_points)
        columns = self.columns[:split][turned]
        cross = (J_inverse @ self.covariance[columns]).reshape(new.size, len(self.covariance))
        P_new = (J_inverse @ cross.T[columns]).reshape(new.size, new.size)
        return replace(
            self,
            anchors=self.anchors[used],
            inverse_depth=self.inverse_depth[staying],
            anchor_of=(np.cumsum(used) - 1)[self.anchor_of[staying]],
            points=np.vstack([self.points[points], new]),
            ids=np.concatenate([self.ids[:split][staying], self.ids[split:][points], self.ids[:split][turned]]),
            covariance=extended(selected(self.covariance, rows), cross[:, rows], P_new),
        )

    def log_distances(self) -> tuple[NDArray[np.bool_], Array, Array]:
        """Which landmarks are in front of the camera (N,), all log distances (N,) and Jacobians (N, 6) by `columns`."""
        points = self.positions
        front = points[:, 2] > 0
        front[: len(self.inverse_depth)] &= self.inverse_depth[:, 2] > 0
        square = np.maximum((points**2).sum(axis=1), 1e-18)
        jacobian = (points / square[:, None])[:, None] @ self.J_landmark
        return front, 0.5 * np.log(square), jacobian[:, 0]

    def _mean_log_distance(self) -> Array | None:
        """(n,) Jacobian of the mean log distance, in which the certain ones weigh most; None without landmarks."""
        front, _, jacobian = self.log_distances()
        if not front.any():
            return None
        variances = each_transformed(self.covariance, jacobian[:, None], self.columns)[:, 0, 0]
        weight = front / (variances + MIN_LOG_VARIANCE)
        mean = np.zeros(len(self.covariance))
        np.add.at(mean, self.columns, (weight / weight.sum())[:, None] * jacobian)
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
