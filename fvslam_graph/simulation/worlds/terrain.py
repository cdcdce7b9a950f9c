"""The world of `synthetic:uav`: open country with relief below a small UAV."""

from __future__ import annotations

from functools import cached_property

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.random_streams import stream
from fvslam_graph.simulation.worlds.boxes import Box
from fvslam_graph.simulation.worlds.country_textures import country
from fvslam_graph.simulation.worlds.relief import PERIOD, Relief
from fvslam_graph.simulation.worlds.ripmap import Grey, RipMap
from fvslam_graph.simulation.worlds.street_textures import CAR, CAR_ENDS, car_paint
from fvslam_graph.simulation.worlds.view import fade, length, rays

_HAZE = (250.0, 500.0)  # metres over which the ground fades
_SKY = 185.0  # grey value
_MARCHES, _SECANTS = 8, 4
_SHALLOWEST = np.float32(-0.1)  # of a secant; shallower ones would throw the next step far away


class Terrain:
    """Open country; z points up and z = 0 is its mean plane.

    Args:
        camera: Without distortion.
        seed: The country's; its textures are made when the first image is asked for (a second, 64 MB).
    """

    def __init__(self, camera: Camera, seed: int) -> None:
        self.camera = camera
        self._seed = seed

    @cached_property
    def relief(self) -> Relief:
        """The ground's shape."""
        return Relief(stream(self._seed, "relief"))

    @cached_property
    def _texture(self) -> RipMap:
        return country(stream(self._seed, "country"))

    @cached_property
    def _paint(self) -> RipMap:
        return car_paint(stream(self._seed, "paint"))

    def car(self, place: NDArray[np.float64], ahead: NDArray[np.float64], shade: float) -> Box:
        """A car on the ground with its middle at `place`, (2,) metres, that drives in the direction `ahead`, (2,)."""
        length, width, height = CAR
        along, across = length * np.append(ahead, 0.0), width * np.array([-ahead[1], ahead[0], 0.0])
        x, y = place.astype(np.float32)[:, None, None]
        corner = np.append(place, float(self.relief.height(x, y)[0, 0])) - along / 2 - across / 2
        return Box(corner, along, across, height, self._paint, ends=(0.0, CAR_ENDS), shade=shade)

    def render(self, pose: gtsam.Pose3) -> Grey:
        """The image (H, W), grey values, from world_T_camera."""
        x0, y0, _ = pose.translation()
        slant_x, slant_y, fall = self._slants(pose)
        drop = self._drop(pose, slant_x, slant_y)
        x, y = drop * slant_x, drop * slant_y

        (Rxx, Rxy, _), (Ryx, Ryy, _), (Rzx, Rzy, _) = (pose.rotation().matrix() / self.camera.fx).astype(np.float32)
        span = drop / fall
        dx = span * length(Rxx + slant_x * Rzx, Rxy + slant_x * Rzy)
        dy = span * length(Ryx + slant_y * Rzx, Ryy + slant_y * Rzy)
        period = self._texture.period[0]  # 205 m; the relief's, 276 m, is no multiple of it
        ground = self._texture.sample(x + np.float32(x0 % period), y + np.float32(y0 % period), dx, dy)
        ground += self.relief.tone(x + np.float32(x0 % PERIOD), y + np.float32(y0 % PERIOD))
        return np.float32(_SKY) + fade(length(x, y), *_HAZE) * (ground - np.float32(_SKY))

    def depth(self, pose: gtsam.Pose3) -> Grey:
        """Distance (H, W) along the optical axis of what each pixel sees, metres."""
        slant_x, slant_y, fall = self._slants(pose)
        return self._drop(pose, slant_x, slant_y) / fall

    def _slants(self, pose: gtsam.Pose3) -> tuple[Grey, Grey, Grey]:
        """Metres that each ray goes along x and y per metre that it falls, and metres that it falls per unit depth."""
        ray_x, ray_y, ray_z = rays(self.camera, pose.rotation())
        fall: Grey = np.maximum(-ray_z, np.float32(1e-3))  # rays above the horizon end in the haze
        return ray_x / fall, ray_y / fall, fall

    def _drop(self, pose: gtsam.Pose3, slant_x: Grey, slant_y: Grey) -> Grey:
        """How far below the camera each ray meets the ground, metres.

        `drop` metres below the camera a ray is at (x0, y0) + drop * slant. Steps that cannot pass through the steepest
        slope bring it near the first intersection; the secant method ends within a millimetre of it.
        """
        x0, y0 = (np.float32(c % PERIOD) for c in pose.translation()[:2])
        z0 = np.float32(pose.z())

        def gap(drop: Grey) -> Grey:
            return z0 - drop - self.relief.height(x0 + drop * slant_x, y0 + drop * slant_y)

        safe: Grey = np.reciprocal(1 + self.relief.steepest * length(slant_x, slant_y))
        drop: Grey = np.full_like(slant_x, z0 - np.float32(self.relief.highest))
        for _ in range(_MARCHES):
            last, last_gap = drop, gap(drop)
            drop = last + safe * last_gap
        for _ in range(_SECANTS):
            now = gap(drop)
            step = drop - last
            step[step == 0] = 1  # it is there; `now` is 0, too
            slope: Grey = np.minimum((now - last_gap) / step, _SHALLOWEST)
            last, last_gap = drop, now
            drop = last - now / slope
        return drop
