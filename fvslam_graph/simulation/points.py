"""Tracks without images: landmarks in space, projected exactly, for fast tests and Monte-Carlo runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Image
from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.random_streams import stream
from fvslam_graph.core.sequence import Ground, Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.simulation.worlds.drive import KITTI, drive_middle, drive_motion
from fvslam_graph.simulation.worlds.motion import RATE, Motion
from fvslam_graph.simulation.worlds.uav import DEPRESSION, View, uav_camera, uav_motion

Array = NDArray[np.float64]
Surface = Callable[[Array, Array, np.random.Generator], Array]
"""Origins (N, 3) and directions (N, 3) of rays, world, to how many directions away something is seen, (N,)."""

_DIGITS = 4  # pixels that hold a frame's number
_NEAREST_LANDMARK = 0.5  # metres; nearer landmarks are not seen
_HOUSES = 8.5  # metres from the middle of the street
_STREET_REACH = 60.0  # metres; how far along the street landmarks are seen
_CLUTTER = 0.3  # share of landmarks that stand in front of walls and road
_RELIEF = 0.35  # metres, standard deviation of the ground below the UAV


class SceneObservation(NamedTuple):
    """Landmarks seen in one frame: ids (N,) ascending, pixels (N, 2), and which pixels (N,) are somewhere else."""

    ids: NDArray[np.int64]
    pixels: Array
    is_outlier: NDArray[np.bool_]


class Matches(NamedTuple):
    """Landmarks seen in two frames: ids (N,) ascending, pixels (N, 2) in each, and which pairs (N,) are wrong."""

    ids: NDArray[np.int64]
    pixels_a: Array
    pixels_b: Array
    is_outlier: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class PointScene:
    """Landmarks along a camera path.

    Attributes:
        camera: What they are projected with.
        trajectory: world_T_camera of each frame.
        landmarks: (M, 3), world, metres; a landmark's id is its row.
        lives: (M, 2) the first frame in which a landmark can be seen, and the one after the last.
        noise: Standard deviation of a pixel's error along each axis.
        outliers: Share of the pixels that are anywhere in the image instead.
        seed: Of noise and outliers.
        reach: Depth, metres, beyond which landmarks are not seen.
        ground: What is known of the ground plane.
    """

    camera: Camera
    trajectory: Trajectory
    landmarks: Array
    lives: NDArray[np.int64]
    noise: float = 0.0
    outliers: float = 0.0
    seed: int = 0
    reach: float = np.inf
    ground: Ground | None = None

    def __len__(self) -> int:
        return len(self.trajectory)

    def observe(self, frame: int) -> SceneObservation:
        """The landmarks seen in a frame; the same whenever and in whatever order frames are asked for."""
        pixels, inside = self._project(frame)
        alive = (self.lives[:, 0] <= frame) & (frame < self.lives[:, 1])
        ids = np.flatnonzero(inside & alive)
        rng = stream(self.seed, "pixels", frame)
        noise = self.noise * rng.standard_normal(pixels.shape)
        anywhere = rng.uniform(0, (self.camera.width - 1, self.camera.height - 1), pixels.shape)
        is_outlier = rng.random(len(pixels)) < self.outliers
        seen = np.where(is_outlier[:, None], anywhere, pixels + noise)
        return SceneObservation(ids, seen[ids], is_outlier[ids])

    def sequence(self, name: str) -> Sequence:
        """The scene as a recording whose images show nothing but their number, see `frame_number`."""
        shape = self.camera.height, self.camera.width

        def load(index: int) -> Image:
            image = np.zeros(shape, np.uint8)
            image[0, :_DIGITS] = index // 256 ** np.arange(_DIGITS) % 256
            return image

        stamps = self.trajectory.stamps
        return Sequence(name, "points", self.camera, stamps, load, self.trajectory, self.ground)

    def match(self, a: int, b: int) -> Matches:
        """The landmarks seen in both of two frames."""
        first, second = self.observe(a), self.observe(b)
        ids, in_a, in_b = np.intersect1d(first.ids, second.ids, assume_unique=True, return_indices=True)
        wrong = first.is_outlier[in_a] | second.is_outlier[in_b]
        return Matches(ids, first.pixels[in_a], second.pixels[in_b], wrong)

    def in_camera(self, frame: int) -> Array:
        """All landmarks (M, 3) in the camera frame, metres."""
        world_T_camera = self.trajectory.matrices[frame]
        points: Array = (self.landmarks - world_T_camera[:3, 3]) @ world_T_camera[:3, :3]
        return points

    def beside(self, frame: int, ids: NDArray[np.int64], pixels: Array) -> Array:
        """(N, 3) world, metres: what is seen in a frame at pixels (N, 2), each at the depth of a landmark near it."""
        depths = self.in_camera(frame)[ids, 2]
        rays = self.camera.rays(pixels)
        world_T_camera = self.trajectory.matrices[frame]
        points: Array = (depths[:, None] * rays) @ world_T_camera[:3, :3].T + world_T_camera[:3, 3]
        return points

    def exact(self, frame: int, points: Array) -> Array:
        """(N, 2) pixels of points (N, 3), world, in a frame, without noise."""
        world_T_camera = self.trajectory.matrices[frame]
        pixels: Array = self.camera.project((points - world_T_camera[:3, 3]) @ world_T_camera[:3, :3])
        return pixels

    def _project(self, frame: int) -> tuple[Array, NDArray[np.bool_]]:
        """Exact pixels (M, 2), and which are in view."""
        points = self.in_camera(frame)
        pixels = self.camera.project(points)
        inside = np.all((pixels >= 0) & (pixels <= (self.camera.width - 1, self.camera.height - 1)), axis=1)
        return pixels, inside & (points[:, 2] > _NEAREST_LANDMARK) & (points[:, 2] < self.reach)


def frame_number(image: Image) -> int:
    """Which frame of a scene an image is, by the number in its first pixels."""
    return int(image[0, :_DIGITS] @ 256 ** np.arange(_DIGITS))


class SceneOptions(TypedDict, total=False):
    """What may be left out of a PointScene."""

    noise: float
    outliers: float
    seed: int
    reach: float
    ground: Ground | None


def simulate(
    trajectory: Trajectory,
    camera: Camera,
    surface: Surface,
    landmarks: int = 5000,
    life: int | None = None,
    **options: Unpack[SceneOptions],
) -> PointScene:
    """A scene for any camera path: each landmark lies where a random pixel of a random frame meets a surface.

    Args:
        trajectory: world_T_camera of each frame.
        camera: The camera.
        surface: Where rays end; `within` for a range of depths.
        landmarks: Their number.
        life: Frames for which a landmark can be seen at most, among them the random one; without it, for as long as
            it is in view.
        options: As in PointScene.

    Raises:
        SequenceError: A number is out of its range.
    """
    noise, outliers, seed = options.get("noise", 0.0), options.get("outliers", 0.0), options.get("seed", 0)
    if not (
        len(trajectory) >= 1 and landmarks >= 1 and noise >= 0 and 0 <= outliers <= 1 and (life is None or life >= 1)
    ):
        raise SequenceError(
            f"a point scene needs frames and landmarks >= 1, noise >= 0, outliers from 0 to 1 and a life >= 1, "
            f"not {len(trajectory)}, {landmarks}, {noise:g}, {outliers:g} and {life}"
        )
    rng = stream(seed, "landmarks")
    frames = rng.integers(0, len(trajectory), landmarks)
    pixels = rng.uniform(0, (camera.width - 1, camera.height - 1), (landmarks, 2))
    rays = camera.rays(pixels)
    poses = trajectory.matrices[frames]
    directions = np.einsum("nij,nj->ni", poses[:, :3, :3], rays)
    points = poses[:, :3, 3] + surface(poses[:, :3, 3], directions, rng)[:, None] * directions
    lives = np.tile([0, len(trajectory)], (landmarks, 1))
    if life is not None:
        lives = (frames - rng.integers(0, life, landmarks))[:, None] + (0, life)
    return PointScene(camera, trajectory, points, lives, **options)


def within(near: float, far: float) -> Surface:
    """Everything is between two depths, metres, with equal shares for equal ratios of depth."""

    def depths(origins: Array, directions: Array, rng: np.random.Generator) -> Array:
        return near * (far / near) ** rng.random(len(origins))

    return depths


def simulate_drive(frames: int = 100, seed: int = 0, **options: Any) -> PointScene:
    """The drive of `synthetic:drive`: landmarks on its road, on straight walls beside it and in between.

    Args:
        frames: Their number, at 10 Hz.
        seed: Of the path, the landmarks, noise and outliers.
        options: Of `simulate`.
    """
    middle = drive_middle(seed)

    def street(origins: Array, directions: Array, rng: np.random.Generator) -> Array:
        lateral = origins[:, 1] - middle(origins[:, 0])
        _, sideways, up = directions.T
        to_wall = (np.copysign(_HOUSES, sideways) - lateral) / sideways
        to_road = np.where(up < 0, -origins[:, 2] / np.minimum(up, -1e-9), np.inf)
        depths: Array = np.minimum(np.minimum(to_wall, to_road), _STREET_REACH)
        in_front = rng.random(len(depths)) < _CLUTTER
        depths[in_front] *= rng.uniform(0.3, 1, in_front.sum())
        return depths

    motion = drive_motion(seed, frames / RATE)
    return _scene(motion, KITTI, street, frames, "fixed height", {"seed": seed, "reach": _STREET_REACH, **options})


def simulate_flight(frames: int = 100, seed: int = 0, view: View = "downward", **options: Any) -> PointScene:
    """The flight of `synthetic:uav`: landmarks on ground whose heights differ at random, without slopes.

    Args:
        frames: Their number, at 10 Hz.
        seed: Of the path, the landmarks, noise and outliers.
        view: "downward" or "oblique".
        options: Of `simulate`.
    """

    def country(origins: Array, directions: Array, rng: np.random.Generator) -> Array:
        heights = _RELIEF * rng.standard_normal(len(origins))
        depths: Array = (heights - origins[:, 2]) / np.minimum(directions[:, 2], -0.05)
        return depths

    motion = uav_motion(seed, frames / RATE, DEPRESSION[view])
    return _scene(motion, uav_camera((640, 480)), country, frames, "altimeter", {"seed": seed, **options})


def _scene(
    motion: Motion, camera: Camera, surface: Surface, frames: int, source: str, options: dict[str, Any]
) -> PointScene:
    """The scene in the frame of the first camera."""
    stamps = np.arange(frames) / RATE
    scene = simulate(motion.trajectory(stamps), camera, surface, ground=motion.ground(stamps, source), **options)
    start = scene.trajectory.poses[0]
    landmarks = start.transformTo(scene.landmarks.T).T
    return replace(scene, trajectory=scene.trajectory.from_origin(), landmarks=landmarks)
