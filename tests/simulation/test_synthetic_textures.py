"""Textures do not alias, and panels lie where they should."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera
from fvslam_graph.simulation.worlds.boxes import Box
from fvslam_graph.simulation.worlds.panels import Panel, paint, paint_depth
from fvslam_graph.simulation.worlds.patterns import Canvas, noise
from fvslam_graph.simulation.worlds.ripmap import Grey, RipMap

CAMERA = Camera(200, 100, 100, 100, 99.5, 49.5)
FORWARD = gtsam.Pose3(gtsam.Rot3(np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])), np.zeros(3))  # along x, z up


def grey(*values: float) -> Grey:
    return np.array([values], np.float32)


def random_texture() -> tuple[np.ndarray, RipMap]:
    image = np.random.default_rng(0).integers(50, 200, (64, 128), dtype=np.uint8)
    return image, RipMap(image, (0.1, 0.2))


def test_a_fine_sample_is_the_texel_and_the_texture_is_periodic() -> None:
    image, texture = random_texture()
    u, v = grey(3.0, 3.0 + 12.8, 3.0 - 2 * 12.8), grey(5.0, 5.0 - 12.8, 5.0 + 12.8)
    samples = texture.sample(u, v, np.full_like(u, 0.01), np.full_like(u, 0.01))
    np.testing.assert_allclose(samples, image[25, 30], atol=1)
    halfway = texture.sample(grey(12.75), grey(5.0), grey(0.01), grey(0.01))  # between the last and the first column
    assert halfway[0, 0] == pytest.approx((float(image[25, 127]) + image[25, 0]) / 2, abs=1.5)


def test_detail_finer_than_a_pixel_is_averaged_along_each_axis_by_itself() -> None:
    stripes = np.zeros((64, 64), np.uint8)
    stripes[:, ::2] = 200
    texture = RipMap(stripes, (1.0, 1.0))
    u = np.arange(32, dtype=np.float32)[None]
    v, fine, coarse = np.zeros_like(u), np.full_like(u, 0.5), np.full_like(u, 4.0)
    assert np.ptp(texture.sample(u, v, fine, fine)) > 190
    assert np.ptp(texture.sample(u, v, fine, coarse)) > 190
    smooth = texture.sample(u, v, coarse, fine)
    assert np.ptp(smooth) < 2
    assert smooth.mean() == pytest.approx(100, abs=1)


def test_a_coarser_sample_keeps_its_place() -> None:
    """Halving must not shift the texture: a soft blob has its middle at the same place at all pixel sizes."""
    u = np.arange(128, dtype=np.float32)
    blob = 20 + 200 * np.exp(-0.5 * ((u - 64) / 12) ** 2)
    texture = RipMap(np.tile(blob, (32, 1)).astype(np.uint8), (1.0, 1.0))
    for span in (1.0, 1.7, 2.0, 3.3, 6.0):
        row = texture.sample(u[None], np.zeros_like(u)[None], np.full_like(u, span)[None], np.ones_like(u)[None])[0]
        weight = row - row.min()
        assert (weight * u).sum() / weight.sum() == pytest.approx(64, abs=0.05)


def test_noise_is_periodic_with_the_variance_of_its_octaves() -> None:
    field = noise(np.random.default_rng(1), (128, 256), (8, 3.0), (1, 4.0))
    assert 4 < field.std() < 5
    smooth = noise(np.random.default_rng(1), (128, 256), (16, 3.0))
    across_border = np.abs(smooth[:, 0] - smooth[:, -1]).max()
    assert 0 < across_border < 2 * np.abs(np.diff(smooth, axis=1)).max()


def test_drawings_continue_across_the_border() -> None:
    canvas = Canvas(np.zeros((32, 64), np.float32), (0.5, 0.5))
    canvas.rectangles(np.array([[0.0, 8.0]]), (8.0, 4.0), 100)
    filled = canvas.grey > 50
    assert filled[16, :8].all()
    assert filled[16, -7:].all()
    assert filled.sum() * 0.25 == pytest.approx(32, rel=0.2)


def test_a_panel_is_seen_where_its_corners_project() -> None:
    _, texture = random_texture()
    wall = Panel(np.array([10.0, -2, -1]), np.array([2.0, 4, 0]), np.array([0.0, 0, 2]), texture, (0, 0), (4.0, 2.0))
    back = Panel(wall.origin + wall.edge_u, -wall.edge_u, wall.edge_v, texture, (0, 0), (4.0, 2.0))
    for panel, seen in ((wall, False), (back, True)):
        depth = np.full((100, 200), np.inf, np.float32)
        paint_depth(depth, [panel], CAMERA, FORWARD)
        assert np.isfinite(depth).any() == seen
    corners = [wall.origin + a * wall.edge_u + b * wall.edge_v for a in (0, 1) for b in (0, 1)]
    pixels = CAMERA.project(FORWARD.transformTo(np.array(corners).T).T)
    rows, columns = np.nonzero(np.isfinite(depth))
    np.testing.assert_allclose([columns.min(), rows.min()], pixels.min(axis=0), atol=1.1)
    np.testing.assert_allclose([columns.max(), rows.max()], pixels.max(axis=0), atol=1.1)
    # In the middle column, y = 0: half way along the edge, at depth 11 m.
    assert depth[50, 99] == pytest.approx(11, abs=0.05)


def test_a_panel_that_passes_the_camera_is_cut() -> None:
    _, texture = random_texture()
    road = Panel(
        np.array([-50.0, -5, -1.65]), np.array([100.0, 0, 0]), np.array([0, 10.0, 0]), texture, (0, 0), (100, 10)
    )
    depth = np.full((100, 200), np.inf, np.float32)
    paint_depth(depth, [road], CAMERA, FORWARD)
    assert not np.isfinite(depth[:50]).any()
    assert depth[99, 100] == pytest.approx(1.65 * 100 / 49.5, rel=1e-4)
    image = np.zeros((100, 200), np.float32)
    paint(image, [road], CAMERA, FORWARD)
    assert np.isfinite(image).all()
    assert image[99, 100] > 50


def test_neighbouring_faces_of_a_box_leave_no_gap() -> None:
    texture = RipMap(np.full((16, 16), 100, np.uint8), (1.0, 1.0))
    box = Box(np.array([8.0, -1, -1]), np.array([3.0, 1, 0]), np.array([0.0, 2, 0]), 1.5, texture)
    image = np.full((100, 200), 255, np.float32)
    paint(image, box.panels, CAMERA, FORWARD)
    inside = image[47:60, 83:110]  # a part of the end, of the left side, and the edge between them
    assert len(np.unique(inside.round(2))) > 1
    assert inside.max() < 125
    assert box.clearance(np.array([0.0, 0, 0])) == pytest.approx(8, rel=0.1)
    assert box.clearance(np.array([9.0, 0.3, 0])) < 0
