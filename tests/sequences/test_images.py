import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera, Distortion
from fvslam_graph.core.errors import CameraError, SequenceError
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


def test_a_jpeg_ends_at_its_marker(tmp_path, gray):
    """Cameras put data after the end, and a preview with an end of its own before it."""
    path = tmp_path / "image.jpg"
    ok, data = cv2.imencode(".jpg", gray)
    ok_preview, preview = cv2.imencode(".jpg", gray[:16, :16])
    assert ok and ok_preview
    data, preview = data.tobytes(), preview.tobytes()
    exif = b"\xff\xe1" + (len(preview) + 2).to_bytes(2, "big") + preview
    with_preview = data[:2] + exif + data[2:]
    for complete in (data, data + b"\n", data + preview[:50], with_preview, with_preview + b"DJI\0\0x"):
        path.write_bytes(complete)
        assert gray_of(path).shape == (48, 64)
    for cut in (with_preview[: len(exif) + 100], with_preview[:-2], with_preview[:-2] + b"DJI"):
        path.write_bytes(cut)
        assert gray_of(path) is None


def test_a_png_ends_at_its_marker(tmp_path, gray):
    path = tmp_path / "image.png"
    cv2.imwrite(str(path), gray)
    path.write_bytes(path.read_bytes() + b"\nmore")
    assert np.array_equal(gray_of(path), gray)


@pytest.mark.parametrize(("bits", "highest"), [(8, 250), (10, 900), (12, 3552), (14, 9000), (16, 60_000)])
def test_levels_of_a_camera_are_scaled_by_one_factor(tmp_path, gray, bits, highest):
    paths = [tmp_path / f"{number}.png" for number in range(3)]
    levels = (gray.astype(float) / gray.max() * highest).astype(np.uint16)
    for factor, path in zip((0.5, 1, 0.2), paths, strict=True):
        cv2.imwrite(str(path), (factor * levels).astype(np.uint16))
    images = ImageFiles(paths)
    assert images.depth == bits
    load = images.loader(CAMERA, "the test")
    assert np.array_equal(load(1), levels >> (bits - 8))
    assert np.array_equal(load(0), (0.5 * levels).astype(np.uint16) >> (bits - 8))
    notes = images.notes(CAMERA)
    assert len(notes) == (bits < 16)
    assert all(f"to {highest}: taken as {bits} bits" in note for note in notes)


def test_levels_above_those_of_the_sample_are_white(tmp_path, gray, monkeypatch):
    monkeypatch.setattr("fvslam_graph.sequences.images.IMAGES_LOOKED_AT", 2)
    paths = [tmp_path / f"{number}.png" for number in range(3)]
    for path, factor in zip(paths, (4, 16, 4), strict=True):
        cv2.imwrite(str(path), gray.astype(np.uint16) * factor)
    image = loader(paths)(1)
    assert image.dtype == np.uint8 and np.array_equal(image, np.minimum(4 * gray.astype(int), 255))


def test_images_without_levels_that_are_known(tmp_path, gray):
    for kind in (np.float32, np.int32):
        cv2.imwrite(str(tmp_path / "0.tif"), gray.astype(kind))
        with pytest.raises(SequenceError, match=r"none of the 1 images can be decoded, .*read are 8 and 16 bits"):
            ImageFiles([tmp_path / "0.tif"])


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_colour_and_alpha(tmp_path, gray, channels, kind):
    cv2.imwrite(str(tmp_path / "0.png"), np.dstack([gray] * channels).astype(kind))
    assert np.array_equal(loader([tmp_path / "0.png"])(0), gray)


def test_the_size_of_most_images_counts(tmp_path, write_images):
    first = write_images(tmp_path, ["0.png"], (1, 1))
    others = write_images(tmp_path, [f"{number}.png" for number in range(1, 6)])
    images = ImageFiles(first + others)
    assert images.size == (64, 48)
    load = images.loader(CAMERA, "the test")
    assert load(0) is None and load(1) is not None
    assert images.notes(CAMERA) == ("1 of the 6 images looked at are not of 64x48 pixels and left out, such as 0.png",)


def test_the_calibrated_size_counts_before_that_of_most(tmp_path, write_images):
    paths = write_images(tmp_path, ["0.png", "1.png"])
    paths += write_images(tmp_path, [f"{number}.png" for number in range(2, 7)], (32, 24))
    images = ImageFiles(paths)
    load = images.loader(CAMERA, "the test")
    assert [load(index) is None for index in range(7)] == [False, False, *[True] * 5]
    assert "5 of the 7 images looked at are not of 64x48 pixels" in images.notes(CAMERA)[0]


def test_an_image_that_would_fill_the_memory_is_not_decoded(tmp_path, gray):
    path = tmp_path / "image.png"
    cv2.imwrite(str(path), gray)
    data = bytearray(path.read_bytes())
    data[16:20] = (20_000).to_bytes(4, "big")
    path.write_bytes(data)
    assert gray_of(path) is None


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "0.png")
    assert gray_of(tmp_path / "0.png") is None
