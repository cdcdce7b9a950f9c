"""The camera: where rays meet the image, with and without lens distortion, and the removal of the latter."""

import cv2
import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera, Distortion, Rectifier
from fvslam_graph.core.errors import CameraError

PINHOLE = Camera(640, 480, 450.0, 455.0, 318.0, 242.0)
RADTAN = Camera(  # EuRoC, cam0
    752, 480, 458.654, 457.296, 367.215, 248.375, Distortion.RADTAN, (-0.28340811, 0.07395907, 0.00019359, 1.76e-05)
)
RADTAN_5 = Camera(  # KITTI raw, unrectified
    1392, 512, 984.24, 980.81, 690.0, 233.2, Distortion.RADTAN, (-0.37288, 0.20373, 0.00222, 0.00138, -0.07234)
)
FISHEYE = Camera(640, 512, 290.0, 291.0, 315.0, 257.0, Distortion.EQUIDISTANT, (0.0035, 0.0007, -0.002, 0.0002))
RATIONAL = Camera(  # a depth camera, 8 coefficients
    640, 512, 305.0, 305.1, 321.0, 258.0, Distortion.RATIONAL, (2.5, 1.2, 1e-4, -2e-4, 0.05, 2.8, 1.9, 0.3)
)
ALL = pytest.mark.parametrize(
    "camera", [PINHOLE, RADTAN, RADTAN_5, FISHEYE, RATIONAL], ids=["none", "k4", "k5", "fisheye", "rational"]
)


def pixels_of(camera: Camera) -> np.ndarray:
    """A grid over the image, (400, 2)."""
    u, v = np.linspace(0, camera.width - 1, 20), np.linspace(0, camera.height - 1, 20)
    return np.stack(np.meshgrid(u, v), axis=2).reshape(-1, 2)


def every_pixel(camera: Camera) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=2).reshape(-1, 2)


def rays_of(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    return np.column_stack([camera.normalize(pixels), np.ones(len(pixels))])


@ALL
def test_normalize_undoes_project(camera):
    pixels = pixels_of(camera)
    depths = np.linspace(0.1, 50, len(pixels))[:, None]
    assert camera.project(depths * rays_of(camera, pixels)) == pytest.approx(pixels, abs=1e-6)


def test_projections_by_hand():
    assert PINHOLE.project(np.array([[1.0, -2.0, 4.0]])) == pytest.approx(np.array([[430.5, 14.5]]))
    # r^2 = 0.05: the radial factor is 1 + 0.1 r^2 + 0.2 r^4, the tangential shift (2 p1 x y + p2 (r^2 + 2 x^2), ...).
    lens = Camera(100, 100, 100.0, 100.0, 50.0, 50.0, Distortion.RADTAN, (0.1, 0.2, 0.01, 0.02))
    x = 0.2 * 1.0055 + 2 * 0.01 * 0.2 * 0.1 + 0.02 * (0.05 + 2 * 0.04)
    y = 0.1 * 1.0055 + 0.01 * (0.05 + 2 * 0.01) + 2 * 0.02 * 0.2 * 0.1
    assert lens.project(np.array([[0.4, 0.2, 2.0]])) == pytest.approx(np.array([[50 + 100 * x, 50 + 100 * y]]))
    # Equidistant: the distance from the centre is f (a + k1 a^3), a being the angle off the axis.
    lens = Camera(100, 100, 100.0, 100.0, 50.0, 50.0, Distortion.EQUIDISTANT, (0.1, 0.0, 0.0, 0.0))
    angle = np.pi / 4
    assert lens.project(np.array([[3.0, 0.0, 3.0]])) == pytest.approx(
        np.array([[50 + 100 * (angle + 0.1 * angle**3), 50]])
    )


@ALL
def test_points_that_are_not_in_front_have_no_pixel(camera):
    points = np.array([[0.1, 0.1, 1.0], [0.1, 0.1, -1.0], [0.1, 0.1, 0.0], [np.nan, 0.0, np.nan]])
    assert np.isfinite(camera.project(points)).all(axis=1).tolist() == [True, False, False, False]
    assert np.isnan(camera.project(points[1:])).all()


@ALL
def test_no_points(camera):
    assert camera.project(np.empty((0, 3))).shape == (0, 2)
    assert camera.normalize(np.empty((0, 2))).shape == (0, 2)


@ALL
@pytest.mark.parametrize("factor", [0.5, 0.3, 1.7])
def test_scaled_keeps_rays(camera, factor):
    small = camera.scaled(factor)
    assert (small.width, small.height) == (round(camera.width * factor), round(camera.height * factor))
    # Pixel areas are kept, so that the outer corners of the image stay the corners.
    ratio = np.array([small.width / camera.width, small.height / camera.height])
    pixels = pixels_of(camera)
    assert small.normalize((pixels + 0.5) * ratio - 0.5) == pytest.approx(camera.normalize(pixels), abs=1e-9)


def test_scaled_fits_images_that_opencv_shrinks():
    camera = Camera(303, 203, 250.0, 250.0, 150.0, 100.0)
    small = camera.scaled(0.3)
    blobs = camera.project(np.array([[-0.5, -0.3, 1.0], [0.5, 0.3, 1.0], [0.4, -0.2, 1.0]]))
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    for blob in blobs:
        image = np.exp(-((u - blob[0]) ** 2 + (v - blob[1]) ** 2) / (2 * 8**2))
        shrunk = cv2.resize(image, (small.width, small.height), interpolation=cv2.INTER_AREA)
        moments = cv2.moments(shrunk)
        centre = np.array([[moments["m10"], moments["m01"]]]) / moments["m00"]
        assert small.normalize(centre) == pytest.approx(camera.normalize(blob), abs=0.01 / small.fx)


@ALL
@pytest.mark.parametrize("target_R_source", [None, gtsam.Rot3.Ypr(0.03, -0.05, 0.02).matrix()], ids=["same", "turned"])
def test_rectified_points_are_where_the_ideal_camera_sees_them(camera, target_R_source):
    target = Camera(400, 300, 180.0, 190.0, 205.0, 140.0)

    def wallpaper(rays):  # up to 6.7 grey values a pixel
        return 127.5 + 60 * np.sin(20 * rays[:, 0] / rays[:, 2]) + 60 * np.cos(20 * rays[:, 1] / rays[:, 2])

    rays = rays_of(target, every_pixel(target))
    in_source = rays if target_R_source is None else rays @ target_R_source
    image = wallpaper(rays_of(camera, every_pixel(camera))).reshape(camera.height, camera.width)
    rectified = Rectifier(camera, target, target_R_source)(np.rint(image).astype(np.uint8))
    assert rectified.shape == (target.height, target.width)

    seen = camera.project(in_source)
    inside = np.all((seen > 1) & (seen < (camera.width - 2, camera.height - 2)), axis=1)
    inside &= np.linalg.norm(in_source[:, :2], axis=1) < 0.9  # the polynomials of real lenses fold back further out
    assert inside.mean() > 0.25
    assert np.abs(rectified.ravel() - wallpaper(in_source))[inside].max() < 1.5  # measured 1.0: rounding, twice


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"fx": np.nan}, "not finite"),
        ({"coefficients": (np.inf, 0.0, 0.0, 0.0), "distortion": Distortion.RADTAN}, "not finite"),
        ({"width": 0}, "image size must be 16 to 10000 pixels a side, not 0x480"),
        ({"height": -1}, "image size must be 16 to 10000 pixels a side, not 640x-1"),
        ({"fx": 0.0}, "focal lengths must be positive, not fx=0"),
        ({"fy": -2.0}, "focal lengths must be positive"),
        ({"coefficients": (0.1,)}, "'none' takes 0 coefficients, not 1"),
        ({"distortion": Distortion.RADTAN, "coefficients": (0.1, 0.1)}, "'radtan' takes 4 or 5 coefficients, not 2"),
        ({"distortion": Distortion.EQUIDISTANT}, "'equidistant' takes 4 coefficients, not 0"),
    ],
)
def test_impossible_calibrations(change, complaint):
    good = {"width": 640, "height": 480, "fx": 450.0, "fy": 450.0, "cx": 320.0, "cy": 240.0}
    Camera(**good)
    with pytest.raises(CameraError, match=complaint):
        Camera(**{**good, **change})


def test_undistorted():
    ideal = RADTAN.undistorted()
    assert (ideal.distortion, ideal.coefficients) == (Distortion.NONE, ())
    assert np.array_equal(ideal.K, RADTAN.K) and (ideal.width, ideal.height) == (752, 480)
