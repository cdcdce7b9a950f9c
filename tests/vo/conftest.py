"""Scenes for visual odometry: points seen twice, a ground plane seen twice, and short flights as images."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import cv2
import gtsam
import numpy as np
import pytest
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.choices import ScaleSource
from fvslam_graph.core.config import VoSettings, load_config
from fvslam_graph.core.sequence import Frame, Sequence
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.core.vo_estimate import CalibrationEvidence, VoEstimate
from fvslam_graph.evaluation.nees import nees
from fvslam_graph.simulation.points import simulate, within
from fvslam_graph.simulation.synthetic import synthetic_sequence
from fvslam_graph.vo.odometry import VisualOdometry
from fvslam_graph.vo.relative_pose import estimate_relative_pose


class Scene(NamedTuple):
    """Points seen by a camera in two places."""

    tracks: Tracks
    points: NDArray[np.float64]  # (N, 3) in the previous camera
    is_outlier: NDArray[np.bool_]


@pytest.fixture(scope="session")
def camera() -> Camera:
    return Camera(640, 480, 450.0, 450.0, 319.5, 239.5)


@pytest.fixture(scope="session")
def two_views(camera: Camera) -> Callable[..., Scene]:
    """Makes some 350 points between two depths, seen from the origin and from `prev_T_cur`."""

    def make(
        prev_T_cur: gtsam.Pose3, near: float = 4.0, far: float = 30.0, landmarks: int = 400, **options: float
    ) -> Scene:
        path = Trajectory(np.array([0.0, 1.0]), (gtsam.Pose3(), prev_T_cur))
        scene = simulate(path, camera, within(near, far), landmarks=landmarks, **options)
        matches = scene.match(0, 1)
        tracks = Tracks.alike(matches.ids, matches.pixels_a, matches.pixels_b)
        return Scene(tracks, scene.in_camera(0)[matches.ids], matches.is_outlier)

    return make


@pytest.fixture(scope="session")
def plane_scene(camera: Camera) -> Callable[[int], tuple[Scene, gtsam.Pose3, gtsam.Pose3]]:
    """Makes points of a plane, the motion by which they are seen twice, and the other one that explains it."""

    def make(seed: int) -> tuple[Scene, gtsam.Pose3, gtsam.Pose3]:
        rng = np.random.default_rng(seed)
        pixels = rng.uniform((8, 8), (camera.width - 9, camera.height - 9), (200, 2))
        ray = camera.rays(pixels)
        normal = np.array([0.1, -0.3, 1.0]) / np.linalg.norm([0.1, -0.3, 1.0])
        points = ray / (ray @ normal)[:, None]
        motion = gtsam.Pose3(gtsam.Rot3.Expmap(np.array([0.02, -0.01, 0.03])), np.array([0.06, 0.02, 0.01]))
        current = camera.project(motion.transformTo(points.T).T) + 0.15 * rng.standard_normal((200, 2))
        H = (
            camera.K
            @ motion.inverse().rotation().matrix()
            @ (np.eye(3) - np.outer(motion.translation(), normal))
            @ np.linalg.inv(camera.K)
        )
        _, rotations, translations, normals = cv2.decomposeHomographyMat(H, camera.K)
        others = [
            gtsam.Pose3(gtsam.Rot3(R), t.ravel()).inverse()
            for R, t, n in zip(rotations, translations, normals, strict=True)
            if n[2] > 0 and np.linalg.norm(R - motion.rotation().matrix().T) > 1e-3
        ]
        tracks = Tracks.alike(np.arange(200), pixels, current)
        return Scene(tracks, points, np.zeros(200, bool)), motion, others[0]

    return make


Plane = tuple[NDArray[np.float64], float]
"""Unit normal and distance: normal . X = distance in the previous camera."""


def homography(camera: Camera, prev_T_cur: gtsam.Pose3, plane: Plane) -> NDArray[np.float64]:
    """From previous to current pixels, through four points of the plane that both cameras see."""
    normal, distance = plane
    level = np.cross(normal, [1.0, 0.0, 0.0])
    ahead = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    centre = normal + (5.0 * ahead if np.linalg.norm(ahead) > 0.5 else 0.0)
    corners = [centre + x * level + y * np.cross(normal, level) for x in (-1, 1) for y in (-1, 1)]
    previous = distance * np.array(corners)
    current = prev_T_cur.transformTo(previous.T).T
    return cv2.getPerspectiveTransform(
        camera.project(previous).astype(np.float32), camera.project(current).astype(np.float32)
    )


def texture(camera: Camera, seed: int) -> NDArray[np.uint8]:
    noise = np.random.default_rng(seed).standard_normal((camera.height, camera.width))
    image = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.clip(np.rint(128 + 45 * image / image.std()), 0, 255).astype(np.uint8)


@pytest.fixture(scope="session")
def plane_views() -> Callable[..., tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """Renders two noisy images of a textured plane, of which part of the first, `raised`, may lie on another plane."""

    def render(
        camera: Camera,
        prev_T_cur: gtsam.Pose3,
        ground: Plane,
        seed: int = 0,
        raised: tuple[NDArray[np.bool_], Plane] | None = None,
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        previous = texture(camera, seed)
        size = (camera.width, camera.height)
        moved = homography(camera, prev_T_cur, ground)
        current = cv2.warpPerspective(previous, moved, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        if raised is not None:
            moved = homography(camera, prev_T_cur, raised[1])
            top = cv2.warpPerspective(previous, moved, size, flags=cv2.INTER_CUBIC)
            covered = cv2.warpPerspective(raised[0].astype(np.uint8), moved, size, flags=cv2.INTER_NEAREST)
            current = np.where(covered > 0, top, current)
        rng = np.random.default_rng([seed, 1])
        noisy = [np.rint(image + rng.standard_normal(image.shape)) for image in (previous, current)]
        return tuple(np.clip(image, 0, 255).astype(np.uint8) for image in noisy)

    return render


class Recording(NamedTuple):
    """A sequence with its images already in memory, and what estimates of its motion are worth."""

    sequence: Sequence
    frames: list[Frame]

    def run(
        self,
        images: dict[int, NDArray[np.uint8] | None] | None = None,
        preset: str = "tuned",
        settings: tuple[str, ...] = (),
    ) -> list[VoEstimate]:
        """Estimates of all frames; `images` maps indices to other images than those of the recording."""
        config = load_config(preset, settings=settings)
        true_baseline = self.true_baseline if config.scale.source is ScaleSource.ORACLE else None
        odometry = VisualOdometry(self.sequence.camera, config, self.sequence.ground, true_baseline)
        images = images or {}
        return [odometry.step(replace(frame, image=images.get(frame.index, frame.image))) for frame in self.frames]

    def truth(self, estimate: VoEstimate) -> gtsam.Pose3:
        poses = self.sequence.ground_truth.poses
        return poses[estimate.previous].between(poses[estimate.index])

    def true_baseline(self, a: int, b: int) -> float:
        positions = self.sequence.ground_truth.positions
        return float(np.linalg.norm(positions[a] - positions[b]))

    def errors(self, estimates: list[VoEstimate]) -> NDArray[np.float64]:
        """Rotation (rad) and translation (m) errors in the tangent of each estimate, (N, 6)."""
        return np.array([gtsam.Pose3.Logmap(e.prev_T_cur.mean.between(self.truth(e))) for e in estimates])

    def nees(self, estimates: list[VoEstimate]) -> NDArray[np.float64]:
        return nees(self.errors(estimates), np.array([estimate.prev_T_cur.covariance for estimate in estimates]))[0]

    def relative_lengths(self, estimates: list[VoEstimate]) -> NDArray[np.float64]:
        """Estimated over true distances, (N,)."""
        pairs = [(e.prev_T_cur.mean.translation(), self.truth(e).translation()) for e in estimates]
        return np.array([np.linalg.norm(estimated) / np.linalg.norm(true) for estimated, true in pairs])


def record(world: str, **options: object) -> Recording:
    sequence = synthetic_sequence(world, **options)
    return Recording(sequence, list(sequence))


@pytest.fixture(scope="session")
def flight() -> Recording:
    """Two seconds of looking ahead and down from a UAV."""
    return record("uav", frames=20, size="320x240", camera="oblique")


@pytest.fixture(scope="session")
def slow_flight() -> Recording:
    """Three seconds of looking straight down: small image motion above a plane, which looks like a rotation."""
    return record("uav", frames=30, size="320x240", seed=3)


@pytest.fixture(scope="session")
def drive() -> Recording:
    """Two seconds on a road between facades."""
    return record("drive", frames=20, size="480x150")


def recalibrated(camera: Camera, pixels: np.ndarray, focal: float, k1: float) -> np.ndarray:
    """Pixels as the camera of the file would see what is in them with another focal length (logarithm) and k1."""
    seen = camera.normalize(pixels) * np.exp(-focal)
    seen = seen / (1 + k1 * (camera.normalize(pixels) ** 2).sum(axis=1, keepdims=True))
    return camera.project(np.column_stack([seen, np.ones(len(seen))]))


@pytest.fixture(scope="session")
def pair(camera: Camera, two_views: Callable[..., Scene]) -> Callable[..., CalibrationEvidence]:
    """Makes what two views of a camera that goes ahead and turns say of its calibration, seen through a true one."""

    def make(true: Camera, noise: float, seed: int, turn: float = 0.1) -> CalibrationEvidence:
        rng = np.random.default_rng(seed)
        rotation = gtsam.Rot3.Expmap(turn * rng.standard_normal(3))
        tracks = two_views(gtsam.Pose3(rotation, np.array([0.3, 0.1, 1.0])), seed=seed).tracks
        seen = [
            true.project(camera.rays(pixels)) + noise * rng.standard_normal(pixels.shape)
            for pixels in (tracks.keyframe, tracks.current)
        ]
        relative_pose = estimate_relative_pose(Tracks.alike(tracks.ids, *seen), camera, VoSettings(), seed=0)
        assert relative_pose is not None and relative_pose.evidence is not None
        return relative_pose.evidence

    return make
