"""Random states of the filter, and derivatives by finite differences."""

from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.slam.covariances import symmetric
from fvslam_graph.slam.initialisation import equal_depths, with_new_landmarks
from fvslam_graph.slam.state import State

Array = NDArray[np.float64]


@pytest.fixture(scope="session")
def camera() -> Camera:
    return Camera(640, 480, 450.0, 440.0, 319.5, 239.5)


def random_covariance(rng: np.random.Generator, size: int, sigma: float) -> Array:
    mixing = sigma * rng.standard_normal((size, size)) / np.sqrt(size)
    return symmetric(mixing @ mixing.T)


@pytest.fixture
def random_state(camera: Camera) -> Callable[..., State]:
    """Makes a camera in motion with landmarks of both kinds, some anchored elsewhere, all in view."""

    def make(seed: int, inverse: int = 6, points: int = 4, sigma: float = 0.01) -> State:
        rng = np.random.default_rng(seed)
        state = State.at(gtsam.Pose3.Expmap(rng.standard_normal(6)), np.zeros((6, 6)))
        pixels = rng.uniform((40, 40), (600, 440), (inverse + points, 2))
        # The first has an anchor of its own, then two each have one in common.
        for few in np.split(np.arange(inverse + points), np.arange(1, inverse + points, 2)):
            prior = equal_depths(len(few), 5.0, 0.1, len(state.covariance))
            state = with_new_landmarks(state, few, pixels[few], prior, camera, 0.5)
        anchors = 0.3 * rng.standard_normal(state.anchors.shape)
        inverse_depth = state.inverse_depth.copy()
        inverse_depth[:, 2] = rng.uniform(0.05, 0.4, len(inverse_depth))
        velocity = np.concatenate([0.5 * rng.standard_normal(3), 2 * rng.standard_normal(3)])
        state = replace(state, anchors=anchors, inverse_depth=inverse_depth, velocity=velocity)
        everything = np.arange(inverse + points)
        state = state.without(everything < 0, everything >= inverse)
        return replace(state, covariance=random_covariance(rng, len(state.covariance), sigma))

    return make


def difference(before: State, after: State) -> Array:
    """The error state (n,), with no change of scale, that leads from one state to the other."""
    return np.concatenate(
        [
            before.world_T_camera.localCoordinates(after.world_T_camera),
            [0.0],
            after.velocity - before.velocity,
            [after.odometry_scale - before.odometry_scale],
            (after.anchors - before.anchors).ravel(),
            (after.inverse_depth - before.inverse_depth).ravel(),
            (after.points - before.points).ravel(),
        ]
    )


def numeric(function: Callable[[Array], Array], size: int, step: float = 1e-6) -> Array:
    """The Jacobian of `function` at zero by central differences."""
    columns = [(function(step * e) - function(-step * e)) / (2 * step) for e in np.eye(size)]
    return np.stack(columns, axis=-1)


def agrees(analytic: Array, numerical: Array) -> bool:
    """Within 1e-6 of the largest entry."""
    return bool(np.abs(analytic - numerical).max() < 1e-6 * max(1.0, np.abs(numerical).max()))
