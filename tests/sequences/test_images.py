from pathlib import Path

import cv2
import numpy as np
import pytest

from fvslam_graph.camera import Camera, Distortion
from fvslam_graph.errors import CameraError, SequenceError
from fvslam_graph.sequences.images import ImageFiles, decode, eight_bits

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)


def gray_of(path, depth=16):
    levels = decode(path)
    return None if levels is None else eight_bits(levels, depth)


def loader(paths, camera=CAMERA, calibration="the test"):
    return ImageFiles(paths).loader(camera, calibration)


@pytest.fixture
def gray():
    return cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (48, 64), np.uint8), (0, 0), 2)


@pytest.mark.parametrize("suffix", [".png", ".pgm", ".bmp", ".tif"])
def test_gray_images_are_read_exactly(tmp_path, gray, suffix):
    path = tmp_path / f"image{suffix}"
    cv2.imwrite(str(path), gray)
    assert np.array_equal(gray_of(path), gray)


def test_sixteen_bits_keep_the_upper_eight(tmp_path, gray):
    cv2.imwrite(str(tmp_path / "deep.png"), gray.astype(np.uint16) * 256 + 77)
    assert np.array_equal(gray_of(tmp_path / "deep.png"), gray)


def test_colour_becomes_luma(tmp_path):
    cv2.imwrite(str(tmp_path / "green.png"), np.full((48, 64, 3), (0, 100, 0), np.uint8))
    image = gray_of(tmp_path / "green.png")
    assert image.shape == (48, 64) and image.dtype == np.uint8
    assert np.all(np.abs(image.astype(int) - 59) <= 1)  # 0.587 * 100


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".pgm"])
@pytest.mark.parametrize("kept", [0.0, 0.5, 0.99])
def test_truncated_images_are_unreadable(tmp_path, gray, suffix, kept):
    path = tmp_path / f"image{suffix}"
    cv2.imwrite(str(path), gray)
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    assert gray_of(path) is None


def test_padded_images_are_read(tmp_path, gray):
    path = tmp_path / "image.jpg"
    cv2.imwrite(str(path), gray)
    path.write_bytes(path.read_bytes() + bytes(100))
    assert gray_of(path) is not None


def test_no_image_and_no_file_are_unreadable(tmp_path):
    (tmp_path / "text.png").write_text("this is no image")
    assert gray_of(tmp_path / "text.png") is None
    assert gray_of(tmp_path / "absent.png") is None
    assert gray_of(tmp_path) is None


def test_size_mismatch_names_both_sizes(tmp_path, write_images):
    paths = write_images(tmp_path, ["0.png", "1.png"], (32, 24))
    with pytest.raises(CameraError, match=r"0\.png is 32x24 pixels, but calib\.txt is for 64x48"):
        loader(paths, CAMERA, Path("calib.txt"))


def test_nothing_decodable_is_an_error(tmp_path):
    (tmp_path / "0.png").write_text("no image")
    with pytest.raises(SequenceError, match=r"none of the 2 images can be decoded, the first is .*0\.png"):
        ImageFiles([tmp_path / "0.png", None, tmp_path / "1.png"])


def test_frames_are_read_when_asked_for_and_bad_ones_are_none(tmp_path, write_images):
    paths = write_images(tmp_path, ["0.png", "1.png", "2.png"])
    write_images(tmp_path, ["other.png"], (32, 24))
    load = loader([None, *paths, tmp_path / "other.png"], CAMERA, "the test")
    assert load(0) is None
    assert [int(load(i)[0, 0]) for i in (3, 1, 2)] == [20, 0, 10]
    assert load(4) is None
    paths[1].unlink()
    assert load(2) is None


def test_distortion_is_removed(tmp_path):
    # A bright dot where the distorted camera sees a point must come to where the ideal camera sees it.
    camera = Camera(320, 240, 200.0, 200.0, 159.5, 119.5, Distortion.RADTAN, (-0.3, 0.1, 0.0, 0.0))
    point = np.array([[0.5, 0.3, 1.0]])
    seen, wanted = camera.project(point)[0], camera.undistorted().project(point)[0]
    assert np.linalg.norm(seen - wanted) > 5
    v, u = np.mgrid[:240, :320]
    image = 255 * np.exp(-((u - seen[0]) ** 2 + (v - seen[1]) ** 2) / 18)
    cv2.imwrite(str(tmp_path / "dot.png"), image.astype(np.uint8))
    rectified = loader([tmp_path / "dot.png"], camera, "the test")(0).astype(float)
    centre = np.array([np.sum(u * rectified), np.sum(v * rectified)]) / rectified.sum()
    assert np.linalg.norm(centre - wanted) < 0.5  # the dot itself is stretched a little
