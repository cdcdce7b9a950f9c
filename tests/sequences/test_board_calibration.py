"""Boards rendered with a known camera, from sides that are known."""

import re
from dataclasses import replace

import cv2
import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera, Distortion
from fvslam_graph.core.errors import CameraError, SequenceError
from fvslam_graph.sequences.board_calibration import calibrate
from fvslam_graph.sequences.boards import BoardView, charuco, checkerboard, find_board
from fvslam_graph.sequences.calibration import read_calibration

CAMERA = Camera(480, 360, 420.0, 421.5, 243.0, 176.0, Distortion.RADTAN, (-0.12, 0.03, 0.0, 0.0))
SQUARE = 0.03  # metres
VIEWS = 14


@pytest.fixture(scope="module")
def normalized():
    """Undistorted image coordinates of all pixels, (H, W, 2)."""
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    return CAMERA.normalize(pixels).reshape(CAMERA.height, CAMERA.width, 2)


def poses(views, tilt=0.55):
    """camera_T_board, with the board before the camera, tilted to all sides."""
    rng = np.random.default_rng(1)
    for number in range(views):
        angle = 2 * np.pi * number / views
        turned = gtsam.Rot3.Rodrigues(tilt * np.cos(angle), tilt * np.sin(angle), rng.uniform(-0.3, 0.3))
        yield gtsam.Pose3(turned, np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.4, 0.5)]))


def render(pattern, normalized, pose, rng):
    """An image of a board in the plane z = 0 whose brightness is a function of x and y, metres."""
    inverse = np.linalg.inv(np.column_stack([pose.rotation().matrix()[:, :2], pose.translation()]))
    on_board = normalized @ inverse[:, :2].T + inverse[:, 2]
    levels = pattern(on_board[..., 0] / on_board[..., 2], on_board[..., 1] / on_board[..., 2])
    levels = cv2.GaussianBlur(levels, None, 0.7) + rng.normal(0, 2, levels.shape)
    return np.clip(levels, 0, 255).astype(np.uint8)


def checkers(x, y):
    """9x6 inner corners about the origin, on white; edges are soft, so that pixels need no samples within them."""
    across, down = x / SQUARE, y / SQUARE + 0.5
    soft = np.tanh(10 * np.sin(np.pi * across)) * np.tanh(10 * np.sin(np.pi * down))
    return np.where((np.abs(across) < 5) & (np.abs(down - 0.5) < 3.5), 125 + 85 * soft, 210.0)


@pytest.fixture(scope="module")
def photographs(normalized, tmp_path_factory):
    folder = tmp_path_factory.mktemp("photographs")
    rng = np.random.default_rng(0)
    for number, pose in enumerate(poses(VIEWS)):
        assert cv2.imwrite(str(folder / f"{number:02d}.png"), render(checkers, normalized, pose, rng))
    return folder


BOARD = ("--checkerboard", "9x6", "--square", SQUARE)


def test_a_checkerboard(photographs, tmp_path, fvslam):
    out = tmp_path / "camera.yaml"
    code, said, err = fvslam("calibrate", photographs, *BOARD, "--out", out)
    assert (code, err) == (0, "")
    assert re.search(r"^by 14 views of a board, 0\.0\d+ pixels root mean square", said, re.MULTILINE)  # measured 0.037
    assert (tmp_path / "camera_residuals.png").stat().st_size > 10_000
    found = {
        line.split(" = ")[0]: [float(n) for n in line.split(" = ")[1].split(" +- ")] for line in said.splitlines()[:8]
    }
    assert found["fx"][0] == pytest.approx(CAMERA.fx, rel=0.003)  # measured 0.0005 at the most, over three boards
    assert found["fy"][0] == pytest.approx(CAMERA.fy, rel=0.003)
    assert abs(found["k1"][0] - CAMERA.coefficients[0]) < 2 * found["k1"][1]  # measured 1.9 at the most
    assert 0.0005 < found["k1"][1] < 0.002
    calibration = read_calibration(out)
    assert calibration.notes == () and calibration.camera.fx == pytest.approx(found["fx"][0], rel=1e-4)
    assert calibration.camera.coefficients == pytest.approx(
        [found[name][0] for name in ("k1", "k2", "p1", "p2")], abs=1e-4
    )

    before = out.read_bytes()
    code, _, err = fvslam("calibrate", photographs, *BOARD, "--out", out)
    assert code == 1 and "camera.yaml exists and is not overwritten; give another name by --out" in err
    assert out.read_bytes() == before


def test_a_video_of_it(photographs, tmp_path):
    path = tmp_path / "board.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (CAMERA.width, CAMERA.height))
    for file in sorted(photographs.iterdir()):
        for _ in range(2):
            writer.write(cv2.imread(str(file)))
    writer.release()
    views, size = find_board(path, checkerboard("9x6", SQUARE))
    assert len(views) >= 24 and size == (CAMERA.width, CAMERA.height)
    calibration = calibrate(path, views, size)
    assert 10 <= len(calibration.views) <= VIEWS  # each once
    assert calibration.camera.fx == pytest.approx(CAMERA.fx, rel=0.005)


def test_a_charuco_board_of_which_a_part_is_seen(normalized, tmp_path):
    board = cv2.aruco_CharucoBoard(
        (9, 7), SQUARE, 0.7 * SQUARE, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    )
    side = 60  # pixels a square
    picture = cv2.GaussianBlur(board.generateImage((9 * side, 7 * side)).astype(np.float32), None, 2.0)

    def pattern(x, y):
        u, v = (x / SQUARE + 4.5) * side - 0.5, (y / SQUARE + 3.5) * side - 0.5
        return cv2.remap(picture, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR, borderValue=210)

    rng = np.random.default_rng(0)
    for number, pose in enumerate(poses(12)):
        near = gtsam.Pose3(pose.rotation(), 0.75 * pose.translation())
        assert cv2.imwrite(str(tmp_path / f"{number}.png"), render(pattern, normalized, near, rng))
    views, size = find_board(tmp_path, charuco("9x7", SQUARE, 0.7 * SQUARE))
    assert len(views) == 12 and min(len(view.points) for view in views) < 48
    calibration = calibrate(tmp_path, views, size)
    assert calibration.camera.fx == pytest.approx(CAMERA.fx, rel=0.01)


def seen(poses, noise=0.1, seed=2):
    """Views without images."""
    corners = checkerboard("9x6", SQUARE).corners
    rng = np.random.default_rng(seed)
    for pose in poses:
        pixels = CAMERA.project(
            np.array([pose.transformFrom(corner - (0.12, 0.075, 0)) for corner in corners.astype(float)])
        )
        yield BoardView("view", corners, (pixels + rng.normal(0, noise, pixels.shape)).astype(np.float32))


SIZE = (CAMERA.width, CAMERA.height)


def test_standard_deviations(tmp_path):
    """Over many boards, errors are as large as they say."""
    errors = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        shaken = [
            gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(0, 0.1, 3)) * pose.rotation(), pose.translation())
            for pose in poses(10)
        ]
        calibration = calibrate(tmp_path, list(seen(shaken, noise=rng.uniform(0.05, 0.3), seed=seed)), SIZE)
        value, sigma = calibration.camera.fx, calibration.sigmas[0]
        errors.append((value - CAMERA.fx) / sigma)
    assert 0.5 < np.std(errors) < 1.6


def test_a_view_that_is_wrong_is_left_out(tmp_path):
    views = list(seen(poses(12)))
    views[5] = replace(
        views[5], pixels=views[5].pixels + np.random.default_rng(0).normal(0, 5, (54, 2)).astype(np.float32)
    )
    calibration = calibrate(tmp_path, views, SIZE)
    assert len(calibration.views) == 11 and calibration.camera.fx == pytest.approx(CAMERA.fx, rel=0.003)


def test_what_does_not_do(tmp_path, photographs, fvslam):
    few, alike, flat = list(seen(poses(5))), list(seen([next(poses(1))] * 20)), list(seen(poses(14, tilt=0.02)))
    with pytest.raises(CameraError, match="shows the board in 5 different views, 8 are needed: move it to all parts"):
        calibrate(tmp_path, few, SIZE)
    with pytest.raises(CameraError, match="shows the board in 1 different views, 8 are needed"):
        calibrate(tmp_path, alike, SIZE)
    with pytest.raises(
        CameraError, match=r"the views are too much alike to tell the focal length, \d+ \+- \d+ pixels: tilt"
    ):
        calibrate(tmp_path, flat, SIZE)
    with pytest.raises(CameraError, match=r"none of the 14 images of .* shows a checkerboard of 8x5 inner corners"):
        find_board(photographs, checkerboard("8x5", SQUARE))
    with pytest.raises(CameraError, match="holds no images"):
        find_board(tmp_path, checkerboard("8x5", SQUARE))
    with pytest.raises(CameraError, match="is no folder of images and no video"):
        find_board(tmp_path / "absent", checkerboard("8x5", SQUARE))
    (tmp_path / "broken.png").write_bytes(b"no image")
    with pytest.raises(SequenceError, match="none of the 1 images can be decoded"):
        find_board(tmp_path, checkerboard("8x5", SQUARE))
    with pytest.raises(
        CameraError, match="the size of a board is written COLUMNSxROWS, as in 9x6, each at least 3, not"
    ):
        checkerboard("9", SQUARE)
    with pytest.raises(CameraError, match="the squares of a board have a side of some metres"):
        checkerboard("9x6", -1)
    with pytest.raises(CameraError, match=r"the markers should be smaller than the squares of 0\.03 m, not 0\.03 m"):
        charuco("9x6", SQUARE, SQUARE)
    out = ("--square", SQUARE, "--out", tmp_path / "camera.yaml")
    for board in ((), ("--charuco", "9x6"), ("--checkerboard", "9x6", "--charuco", "9x6")):
        said = fvslam("calibrate", photographs, *board, *out).err
        assert "a board is --checkerboard with --square, or --charuco with --square and --marker" in said
    whole = ("--checkerboard", "9x6", *out)
    assert "are for a recording, not for a board" in fvslam("calibrate", photographs, *whole, "--stride", 2).err
    assert not (tmp_path / "camera.yaml").exists()
