"""A factor graph fed with motions and landmarks of a simulated scene."""

from collections.abc import Callable
from functools import cache

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.slam_estimate import LandmarkObservations
from fvslam_graph.core.vo_estimate import OdometryStep
from fvslam_graph.graph.factor_graph import Graph
from fvslam_graph.simulation.points import PointScene, simulate_drive

INTERVAL = 2
CLEAN = 4  # frames without wrong motions, at the beginning
PIXEL = 0.3  # noise
MOTION = np.repeat([0.0005, 0.01], 3)  # rad and m, noise of a motion from frame to frame


class Fed:
    """A graph with what it was fed with.

    Attributes:
        graph: After all frames.
        motions: Handed out at each interleaved frame, with the frames they lead from and to.
    """

    def __init__(self, scene: PointScene, settings: GraphSettings, camera: Camera | None = None) -> None:
        self.scene = scene
        self.graph = Graph(camera or scene.camera, settings)
        self.motions: list[tuple[int, int, GaussianPose]] = []

    def error(self) -> float:
        """RMS of the smoothed positions, metres."""
        smoothed = self.graph.smoothed()
        return float(np.sqrt(((smoothed.positions - self.scene.trajectory.positions) ** 2).sum(axis=1).mean()))


@pytest.fixture(scope="session")
def fed() -> Callable[..., Fed]:
    """Feeds a graph, with a share of motions and of pixels that are grossly wrong.

    It follows up to `count` landmarks; unless they are `recognised`, those seen after the darkness are others.
    The graph may believe in another `camera` than the one that sees the scene.
    """

    def make(
        frames: int = 41,
        seed: int = 0,
        noise: float = 1.0,
        wrong: float = 0.0,
        wrong_pixels: float | None = None,
        scene: PointScene | None = None,
        dark: range = range(0),
        recognised: bool = True,
        count: int = 40,
        camera: Camera | None = None,
        **settings: object,
    ) -> Fed:
        scene = scene or simulate_drive(frames=frames, seed=seed, noise=noise * PIXEL, landmarks=150 * frames)
        # Simulated pixels err each on its own.
        consistent = {"pixel_sigma": PIXEL, "common_noise": 0.0, "shared_pixels": "ignore"}
        made = Fed(scene, GraphSettings(**{**consistent, **settings}), camera)  # type: ignore[arg-type]
        rng = np.random.default_rng([seed, 4])
        poses, last, followed = scene.trajectory.poses, 0, np.empty(0, np.int64)
        for index in range(len(scene)):
            previous = max(index - 1, 0)
            motion, covariance = poses[previous].between(poses[index]), np.diag(MOTION**2)
            if index in dark:
                motion, covariance = poses[0].between(poses[1]), 0.3**2 * np.eye(6)
            elif rng.random() < wrong and index > CLEAN:
                motion = motion.retract(rng.uniform(-1, 1, 6) * np.repeat([0.2, 1.0], 3))
            else:
                motion = motion.retract(noise * MOTION * rng.standard_normal(6))
            made.graph.add_odometry(
                float(scene.trajectory.stamps[index]), OdometryStep(previous, GaussianPose(motion, covariance))
            )
            if index % INTERVAL == 0 and index > 0:
                views = None
                if index not in dark:
                    seen = scene.observe(index)
                    followed = np.concatenate(
                        [followed[np.isin(followed, seen.ids)], rng.permutation(np.setdiff1d(seen.ids, followed))]
                    )[:count]
                    rows = np.searchsorted(seen.ids, followed)
                    pixels = seen.pixels[rows]
                    anywhere = rng.random(len(rows)) < (wrong if wrong_pixels is None else wrong_pixels)
                    pixels[anywhere] += rng.uniform(-60, 60, (anywhere.sum(), 2))
                    points = scene.in_camera(index)[followed]
                    if camera is not None:  # by which visual SLAM has them where they are seen
                        seen_at = camera.normalize(scene.camera.project(points))
                        points = points[:, 2:] * np.column_stack([seen_at, np.ones(len(points))])
                    names = followed if recognised or index < dark.start else followed + len(scene.landmarks)
                    views = LandmarkObservations(names, pixels, points, np.tile(0.05**2 * np.eye(3), (len(rows), 1, 1)))
                made.motions.append((last, index, made.graph.fuse(views)))
                last = index
        return made

    return make


@pytest.fixture(scope="session")
def error_fed(fed: Callable[..., Fed]) -> Callable[..., float]:
    """The error of what was fed so; what several tests ask for is fed once."""
    return cache(lambda **options: fed(**options).error())


def error_of(scene: PointScene, first: int, second: int, motion: gtsam.Pose3) -> np.ndarray:
    """Logmap of what a motion between two frames is off by, (6,)."""
    poses = scene.trajectory.poses
    error: np.ndarray = gtsam.Pose3.Logmap(motion.between(poses[first].between(poses[second])))
    return error
