"""Cameras, streams and folders while images come: what is taken, what is dropped, and when it ends."""

import os
import queue
import threading

import cv2
import numpy as np
import pytest

from fvslam_graph.core.errors import CameraError, SequenceError
from fvslam_graph.sequences.images import decode
from fvslam_graph.sequences.latest import LatestImage, LiveImage
from fvslam_graph.sequences.live import LiveCamera, open_live
from fvslam_graph.sequences.live_sources import FolderSource, open_source
from fvslam_graph.sequences.plausibility import camera_of_view

SECOND = 10**9  # ns
START = 1_700_000_000


def write(folder, name, level=0, stamp=None, size=(48, 64)):
    path = folder / name
    rng = np.random.default_rng(level)
    assert cv2.imwrite(str(path), rng.integers(0, 255, size, dtype=np.uint8))
    if stamp is not None:
        os.utime(path, ns=(stamp * SECOND, stamp * SECOND))
    return path


class Scripted:
    """A source that the test hands images to; None is its end, an exception is raised."""

    name = "scripted"

    def __init__(self):
        self.images = queue.Queue()
        self.looks = threading.Semaphore(0)  # how often it was asked
        self.closed = threading.Event()

    def add(self, *images):
        """Hand images on, and wait until the last of them has been kept."""
        for image in images:
            self.images.put(image)
        for _ in images:
            self.looks.acquire()

    def read(self):
        self.looks.release()
        image = self.images.get()
        if image is None:
            raise EOFError
        if isinstance(image, Exception):
            raise image
        return image

    def close(self):
        self.closed.set()


def image(number, missed=0, size=(48, 64), dtype=np.uint8, level=7):
    return LiveImage(np.full(size, level, dtype), float(number), 0.0, missed)


@pytest.fixture
def scripted():
    source = Scripted()
    yield source
    source.images.put(None)  # its thread ends


def test_the_newest_is_taken_and_the_others_are_counted(scripted):
    with LatestImage(scripted) as images:
        scripted.looks.acquire()
        scripted.add(image(1))
        assert images.take().stamp == 1
        scripted.add(image(2), image(3, missed=2), image(4))
        assert (images.take().stamp, images.dropped) == (4, 4)
        scripted.images.put(None)
        assert images.take() is None
    assert scripted.closed.wait(60)


def test_what_had_come_before_the_end_is_taken(scripted):
    with LatestImage(scripted) as images:
        scripted.looks.acquire()
        scripted.add(image(1))
        scripted.images.put(None)
        assert scripted.closed.wait(60)
        assert (images.take().stamp, images.take()) == (1, None)


def test_errors_of_the_source_are_those_of_who_takes(scripted):
    with LatestImage(scripted) as images:
        scripted.images.put(SequenceError("unplugged"))
        with pytest.raises(SequenceError, match="unplugged"):
            images.take()


def test_nothing_is_taken_after_a_stop_or_when_patience_is_over(scripted):
    with LatestImage(scripted) as images:
        assert images.take(patience=1e-3) is None
        scripted.looks.acquire()
        scripted.add(image(1))
        images.stop()
        assert images.take() is None


def test_a_folder_has_new_images_alone(tmp_path):
    write(tmp_path, "1.png", stamp=START)
    source = FolderSource(tmp_path)
    assert source.read() is None
    taken = write(tmp_path, "2.png", 2, START + 1)
    (tmp_path / "notes.txt").write_text("no image")
    write(tmp_path, ".3.png", 3)
    found = source.read()
    assert np.array_equal(found.levels, decode(taken))
    assert (found.stamp, found.missed, source.read()) == (START + 1, 0, None)


def test_the_newest_image_of_a_folder_is_taken(tmp_path):
    source = FolderSource(tmp_path)
    for number in (3, 1, 2):
        write(tmp_path, f"{number}.png", number, START + number)
    assert (found := source.read()).stamp == START + 3 and found.missed == 2
    write(tmp_path, "0.png", 0, START)  # late
    assert source.read() is None
    write(tmp_path, "4.png", 4, START + 4)
    assert (found := source.read()).stamp == START + 4 and found.missed == 1


def test_names_that_are_stamps_tell_them(tmp_path):
    (tmp_path / "images").mkdir()
    source = FolderSource(tmp_path)
    write(tmp_path / "images", f"{START}.25.png")
    assert source.read().stamp == START + 0.25
    write(tmp_path / "images", f"{START * SECOND + SECOND // 2}.png")
    assert source.read().stamp == START + 0.5


@pytest.mark.parametrize("suffix", ["png", "jpg", "pgm", "bmp"])
def test_an_image_is_waited_for_until_it_is_whole(tmp_path, suffix):
    source = FolderSource(tmp_path)
    whole = write(tmp_path, f"2.{suffix}", 2, START + 2)
    content = whole.read_bytes()
    whole.write_bytes(content[: len(content) // 2])
    os.utime(whole, ns=((START + 2) * SECOND,) * 2)
    assert source.read() is None
    write(tmp_path, f"1.{suffix}", 1, START + 1)
    assert (found := source.read()).stamp == START + 1 and found.missed == 0
    assert source.read() is None
    whole.write_bytes(content)
    os.utime(whole, ns=((START + 2) * SECOND,) * 2)
    assert source.read().stamp == START + 2


def test_images_may_be_deleted(tmp_path):
    source = FolderSource(tmp_path)
    for number in range(3):
        path = write(tmp_path, f"{number}.png", number, START + number)
        assert source.read().stamp == START + number
        path.unlink()
        assert source.read() is None
    tmp_path.rmdir()
    with pytest.raises(SequenceError, match="cannot be read"):
        source.read()


def test_frames_of_a_camera(scripted):
    with_other_size = [image(1), image(2, size=(10, 10)), image(3)]
    scripted.images.put(with_other_size[0])
    with LiveCamera(scripted, lambda size: camera_of_view(size, 60)) as camera:
        assert camera.sequence.camera.fx == pytest.approx(32 / np.tan(np.radians(30)))
        assert (camera.sequence.camera.width, camera.sequence.camera.cx, len(camera.sequence)) == (64, 31.5, 0)
        frames = []
        for frame in camera:
            frames.append(frame)
            scripted.images.put(with_other_size[len(frames)] if len(frames) < 3 else None)
    assert [(frame.index, frame.stamp) for frame in frames] == [(0, 1), (1, 2), (2, 3)]
    assert [frame.image is None for frame in frames] == [False, True, False]
    assert np.isnan(frames[0].height)
    assert (camera.taken, len(camera.latencies)) == (3, 3)
    assert camera.summary().startswith("3 frames, 0 dropped; latency ")


def test_sixteen_bits_are_taken_as_deep_as_the_brightest_was(scripted):
    images = [image(n, dtype=np.uint16, level=level) for n, level in enumerate((900, 4000, 900))]
    scripted.images.put(images[0])
    levels = []
    with LiveCamera(scripted, lambda size: camera_of_view(size, 60)) as camera:
        for frame in camera:
            levels.append(int(frame.image[0, 0]))
            scripted.images.put(images[len(levels)] if len(levels) < 3 else None)
    assert levels == [900 // 4, 4000 // 16, 900 // 16]


def test_no_image_at_all(scripted):
    with pytest.raises(SequenceError, match="no image has come from scripted"):
        LiveCamera(scripted, lambda size: camera_of_view(size, 60), patience=1e-3).__enter__()


def test_a_calibration_of_another_size(drive, tmp_path):
    camera = open_live(str(tmp_path), calibration=drive / "camera.yaml")
    write(tmp_path, "1.png")
    with pytest.raises(CameraError, match=r"images are 64x48 pixels, but .*camera.yaml is for 320x100"):
        camera.__enter__()


def test_a_stream(tmp_path):
    """FFmpeg reads a file like any other address."""
    path = tmp_path / "stream.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    for number in range(3):
        writer.write(np.full((48, 64, 3), 40 * number, np.uint8))
    writer.release()
    source = open_source(f"file://{path}")
    images = [source.read() for _ in range(3)]
    assert [float(image.levels.mean()) for image in images] == pytest.approx([0, 40, 80], abs=3)
    assert np.all(np.diff([image.stamp for image in images]) > 0)
    with pytest.raises(EOFError):
        source.read()
    source.close()


@pytest.mark.parametrize(
    ("where", "options", "error"),
    [
        ("absent", {"fov": 60}, "is no folder, no number of a camera, and no address"),
        ("times.csv", {"fov": 60}, "is a file, to which nothing comes"),
        ("images", {}, "nothing is known of the camera of"),
        ("", {"patience": float("inf")}, "must be a positive number of seconds"),
        ("", {"camera_height": -1.0}, "the camera height must be a positive number"),
        ("", {"camera_pitch": 0.1}, "give the camera height along with its pitch"),
    ],
)
def test_what_cannot_be_opened(drive, where, options, error):
    with pytest.raises((SequenceError, CameraError), match=error):
        open_live(str(drive / where), **options)


def test_a_camera_that_is_not_there(tmp_path):
    with pytest.raises(SequenceError, match=r"rtsp://localhost:1/x cannot be opened"):
        open_live("rtsp://user:secret@localhost:1/x", fov=60)


@pytest.mark.parametrize("fov", [0.0, 4.0, 180.0, float("nan")])
def test_fields_of_view_that_are_none(fov):
    with pytest.raises(CameraError, match="the field of view must be 5 to 175 degrees"):
        camera_of_view((64, 48), fov)
