"""Metric scale from a ground plane at known distance.

The inverse depth of a plane is linear in the image: a point with ray x = (x, y, 1) on the plane n . X = d has the
inverse depth p . x with p = n / d. So patches of the ground are aligned between two images, triangulated with the
known relative pose in units of its baseline, and p is fitted to their inverse depths. The length of p is the baseline
over the height.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Image, by_calibration
from fvslam_graph.core.config import GroundSettings
from fvslam_graph.core.inverse_depths import InverseDepths
from fvslam_graph.core.quick import median
from fvslam_graph.features.brightness import relative_brightness
from fvslam_graph.vo.depth import triangulate
from fvslam_graph.vo.epipolar import MatchedRays, epipolar_distance
from fvslam_graph.vo.relative_pose import TwoViews

_PATCH_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 15, 0.02)
_PATCH_WINDOW = (17, 9)  # pixels; wide and low, as the texture of a road seen from a car
_PATCH_LEVELS = 1  # of the pyramid above the full image
_SEARCH = 8.0  # pixels that the ground may lie off its prediction
_HYPOTHESES = 60
_LEVEL = 20  # of these, with the nominal normal
MIN_TRACKS = 10  # on the ground, for a first guess
_RATIOS = np.geomspace(0.05, 4.0, 16)  # baseline over height: what is tried where nothing is expected
LIMIT = 2.0  # tolerances beyond which a patch counts for less, or is no ground; where residuals are smaller,
KERNEL = 4.0  # deviations: so many that relief is averaged
ITERATIONS, CONVERGED = 6, 0.1  # at most, and deviations of a step after which little changes
MIN_SPREAD = 0.05  # of what patches may err: what they do, at least
LOOK_AGAIN = 1.1  # times the distance that was expected, or less by as much,
MAX_LOOKS = 3  # for so many looks at most
STRIDE = 5  # from one of these to the next one tried: all come, and soon some of each size


@dataclass(frozen=True)
class GroundPlane:
    """The ground as two views see it.

    Attributes:
        plane: (3,) p = n / d in the previous camera, d in baselines.
        log_variance: Variance of log |p| from the patches themselves and from the motion between the views.
        patches: How many patches lie on it.
        roughness: How far they lie off it, as a share of what they may.
        J_calibration: (2,) how log |p| changes with the logarithm of the focal length and with k1.
    """

    plane: NDArray[np.float64]
    log_variance: float
    patches: int
    roughness: float
    J_calibration: NDArray[np.float64]


class GroundAligner:
    """Finds the ground plane between two views whose relative pose is known up to scale.

    Args:
        camera: Undistorted.
        normal: (3,) unit vector in the camera towards the ground, nominal.
        normal_sigma: How far the camera tilts from it, radians.
        settings: Extent, number and tolerance of patches.
    """

    def __init__(
        self, camera: Camera, normal: NDArray[np.float64], normal_sigma: float, settings: GroundSettings
    ) -> None:
        self.camera = camera
        self.normal = normal / np.linalg.norm(normal)
        self.normal_sigma = normal_sigma
        self.settings = settings
        self._grid = self._ground_pixels()
        self._rays = camera.rays(self._grid.astype(float))
        self._next = 0  # of the ratios, where what is expected leads nowhere

    def towards(self, normal: NDArray[np.float64], normal_sigma: float) -> GroundAligner:
        """The same for a camera of known attitude: normal (3,) towards the ground, and its deviation in radians."""
        turned = GroundAligner(self.camera, normal, normal_sigma, self.settings)
        turned._next = self._next
        return turned

    def measure(self, views: TwoViews, expected: float | None, rng: np.random.Generator) -> GroundPlane | None:
        """The ground between two images; None where too few patches agree on one.

        Args:
            views: With both images; where nothing is expected, tracks give the first guess.
            expected: Baseline per height, dimensionless; only steers the search. Where it leads to no ground, tracks
                do, or one of a range of ratios, the next one at each call: what is expected may be wrong for good.
                Without it, and without tracks, the whole range is tried and the ground with most patches is taken.
            rng: For the hypotheses.
        """
        likely = None if expected is None else expected * self.normal
        if likely is not None and (ground := self._measure_near(views, likely, rng)):
            return ground
        seen = self._sees_ground(views.rays)
        if seen.sum() >= MIN_TRACKS:
            guess = self._hypothesise(views.rays[seen], views.depths[seen], rng)
            if ground := self._measure_near(views, guess, rng):
                return ground
        ratios = _RATIOS
        if expected is not None:
            self._next = (self._next + STRIDE) % len(_RATIOS)
            ratios = _RATIOS[[self._next]]
        tried = [self._measure_near(views, ratio * self.normal, rng) for ratio in ratios]
        return max(filter(None, tried), key=lambda ground: ground.patches, default=None)

    def _measure_near(
        self, views: TwoViews, plane: NDArray[np.float64], rng: np.random.Generator
    ) -> GroundPlane | None:
        """The ground, if it is near enough to `plane` for its patches to be found.

        Patches that were found far from where they were looked for are seen otherwise than they were taken to be, and
        are looked for again where they were found.
        """
        ground = None
        for _ in range(MAX_LOOKS):
            patches = self._align(views, plane)
            found = None if patches is None else self._refine(*patches, self._hypothesise(*patches, rng))
            if found is None:
                break
            change = float(np.linalg.norm(found.plane) / np.linalg.norm(plane))
            ground, plane = found, found.plane
            if 1 / LOOK_AGAIN < change < LOOK_AGAIN:
                break
        return ground

    def _sees_ground(self, ray: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which rays (N, 3) meet the nominal ground within reach and not too far aside."""
        nearness = ray @ self.normal
        aside = np.cross(self.normal, [0.0, 0.0, 1.0])
        length = np.linalg.norm(aside)
        aside = aside / length if length > 0.5 else np.zeros(3)  # a camera that looks down has no side
        in_reach = nearness > np.linalg.norm(ray, axis=1) / self.settings.reach
        within: NDArray[np.bool_] = in_reach & (np.abs(ray @ aside) < self.settings.half_width * nearness)
        return within

    def _ground_pixels(self) -> NDArray[np.float32]:
        """A grid of pixels that see the ground within range, about as many as there shall be patches."""
        camera = self.camera
        margin = max(_PATCH_WINDOW)
        columns, rows = np.meshgrid(np.arange(margin, camera.width - margin), np.arange(margin, camera.height - margin))
        dense = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float32)
        seen = self._sees_ground(camera.rays(dense.astype(float)))
        step = max(1, round(np.sqrt(seen.sum() / self.settings.patches)))
        grid: NDArray[np.float32] = dense[seen & (dense[:, 0] % step == 0) & (dense[:, 1] % step == 0)]
        return grid

    def _align(self, views: TwoViews, plane: NDArray[np.float64]) -> tuple[NDArray[np.float64], InverseDepths] | None:
        """Rays (N, 3) of ground patches and their inverse depths, found near where `plane` predicts them.

        The current image is warped to the previous view by the predicted plane, so that what is left to align is small
        and free of perspective: a patch of road changes its size by a quarter between two frames.
        """
        previous, current, relative_pose = views.previous.image, views.current.image, views.relative_pose
        if len(self._grid) < self.settings.min_patches or previous is None or current is None:
            return None
        camera, K = self.camera, self.camera.K
        rotation, direction = relative_pose.rotation, relative_pose.direction
        top = max(0, int(self._grid[:, 1].min()) - 2 * _PATCH_WINDOW[1])
        offset = np.array([0.0, top])
        homography = K @ rotation.matrix().T @ (np.eye(3) - np.outer(direction, plane)) @ np.linalg.inv(K)
        shift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, top], [0.0, 0.0, 1.0]])
        warped = cv2.warpPerspective(
            current,
            homography @ shift,
            (camera.width, camera.height - top),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        )
        start = (self._grid - offset).astype(np.float32)
        reach = max(_PATCH_WINDOW) << _PATCH_LEVELS
        before, now = (relative_brightness(image, reach) for image in (previous[top:], warped))
        found, good = _lucas_kanade(before, now, start, start, _PATCH_LEVELS)
        good &= np.hypot(*(found - start).T) < _SEARCH
        in_current = np.column_stack([found[good] + offset, np.ones(good.sum())]) @ homography.T
        ray, ray_current = self._rays[good], camera.rays(in_current[:, :2] / in_current[:, 2:])
        epipolar, _ = epipolar_distance(MatchedRays(ray, ray_current, camera.fx), rotation, direction)
        kept = np.abs(epipolar) < 2**0.5
        if kept.sum() < self.settings.min_patches:
            return None
        ids = np.flatnonzero(good)[kept].astype(np.int64)
        matched = MatchedRays(ray[kept], ray_current[kept], camera.fx)
        depths = triangulate(
            ids,
            matched,
            rotation,
            direction,
            covariance=relative_pose.covariance,
            J_calibration=relative_pose.J_calibration,
        )
        return ray[kept], depths

    def _hypothesise(
        self, ray: NDArray[np.float64], depths: InverseDepths, rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """The plane on which most patches lie.

        Each hypothesis goes through one patch; its normal is drawn, but for some that have the likeliest one: where the
        tilt is hardly known, few of those drawn are near.
        """
        tilts = rng.standard_normal((_HYPOTHESES, 3))
        tilts[:_LEVEL] = 0.0
        normals = self.normal + self.normal_sigma * tilts
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        chosen = rng.integers(len(depths), size=_HYPOTHESES)
        planes = normals * (depths.values[chosen] / (normals * ray[chosen]).sum(axis=1))[:, None]
        predicted = planes @ ray.T
        error = (depths.values - predicted) / self._tolerance(depths, predicted)
        cost = np.minimum(error**2, 9.0).sum(axis=1)
        best: NDArray[np.float64] = planes[int(np.argmin(cost))]
        return best

    def _refine(
        self, ray: NDArray[np.float64], depths: InverseDepths, plane: NDArray[np.float64]
    ) -> GroundPlane | None:
        """Iteratively reweighted least squares (Geman-McClure) with the nominal normal as a prior.

        How far patches may lie off tells them from what is no ground. Most of them tell how far they do: where that is
        little, what lies off by more is a kerb or a wall, which would make the ground seem farther away.
        """
        for _ in range(ITERATIONS):
            length = float(np.linalg.norm(plane))
            if not length > 0:
                return None
            predicted = ray @ plane
            tolerance = self._tolerance(depths, predicted)
            error = (depths.values - predicted) / tolerance
            spread = min(1.0, max(MIN_SPREAD, median(np.abs(error)) / 0.6745))
            weight = (1 + (error / min(LIMIT, KERNEL * spread)) ** 2) ** -2
            weighted = (weight / (spread * tolerance) ** 2)[:, None] * ray
            # Only the components across the normal are known beforehand.
            across = (np.eye(3) - np.outer(self.normal, self.normal)) / (self.normal_sigma * length) ** 2
            normal_matrix = weighted.T @ ray + across
            before, plane = plane, np.linalg.solve(normal_matrix, weighted.T @ depths.values)
            if (plane - before) @ normal_matrix @ (plane - before) < CONVERGED**2:
                break
        patches = int((np.abs(error) < LIMIT).sum())
        along = plane / float(plane @ plane)
        gain = np.linalg.solve(normal_matrix, along)
        by_depth = weighted @ gain  # how log |p| changes with each depth
        # Of what the patches err on their own, and of what the motion makes them err together.
        log_variance = float(along @ gain) + float(((by_depth @ depths.common) ** 2).sum())
        # By another calibration, they are at other depths and are seen elsewhere.
        J_calibration = by_depth @ (depths.J_calibration - by_calibration(ray, plane[:2]))
        if patches < self.settings.min_patches or plane @ self.normal <= 0:
            return None
        return GroundPlane(plane, log_variance, patches, spread, J_calibration)

    def _tolerance(self, depths: InverseDepths, predicted: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.hypot(depths.sigmas, self.settings.roughness * predicted)


def _lucas_kanade(
    a: Image, b: Image, points: NDArray[np.float32], guess: NDArray[np.float32], levels: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        a, b, points, guess.copy(), None, None, _PATCH_WINDOW, levels, _PATCH_STOP, cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    return found, status[:, 0] > 0
