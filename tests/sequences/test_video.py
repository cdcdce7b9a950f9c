import shutil

import cv2
import numpy as np
import pytest

from fvslam_graph.core.errors import CameraError, SequenceError
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.sequences.video import read

FRAMES = 240
CAMERA = "image_width: 64\nimage_height: 48\ncamera_matrix: [50, 0, 31.5, 0, 50, 23.5, 0, 0, 1]\n"


def draw(number):
    """A noisy image whose blocks spell its number in binary, which survives lossy compression."""
    bits = np.array([(number >> bit) & 1 for bit in range(8)]).reshape(2, 4)
    noise = np.random.default_rng(number).integers(0, 80, (48, 64))
    return (np.kron(bits, np.full((24, 16), 170)) + noise).astype(np.uint8)


def number_of(image):
    bits = image.reshape(2, 24, 4, 16).mean(axis=(1, 3)).ravel() > 127
    return int(sum(1 << bit for bit, high in enumerate(bits) if high))


def write_video(path):
    writer = cv2.VideoWriter(
        str(path), cv2.VideoWriter_fourcc(*"mp4v" if path.suffix == ".mp4" else "MJPG"), 25, (64, 48)
    )
    assert writer.isOpened()
    for number in range(FRAMES):
        writer.write(cv2.cvtColor(draw(number), cv2.COLOR_GRAY2BGR))
    return writer


@pytest.fixture
def flight(tmp_path):
    write_video(tmp_path / "flight.mp4").release()
    (tmp_path / "camera.yaml").write_text(CAMERA)
    return tmp_path / "flight.mp4"


def test_frames_in_order(flight):
    sequence = open_sequence(flight)
    assert (sequence.name, sequence.format, len(sequence)) == ("flight", "video", FRAMES)
    np.testing.assert_allclose(sequence.stamps, np.arange(FRAMES) / 25)
    assert [number_of(frame.image) for frame in sequence] == list(range(FRAMES))


def test_frames_in_any_order(flight):
    load = open_sequence(flight).load
    order = [5, 6, 9, 2, 109, 110, 0, FRAMES - 1, 3, 150]
    assert [number_of(load(number)) for number in order] == order


def unsteady(data: bytes) -> bytes:
    """The mp4 file with half the time between frames in its first half: another table of times for the one it has."""
    start, following = data.index(b"stts") - 4, data.index(b"stss") - 4
    end = following + int.from_bytes(data[following : following + 4], "big")
    count, step = (int.from_bytes(data[at : at + 4], "big") for at in (start + 16, start + 20))
    assert following == start + 24 and count == FRAMES
    numbers = (32, 2, FRAMES // 2, step // 2, FRAMES // 2, step)
    size, entries, *table = (number.to_bytes(4, "big") for number in numbers)
    times = size + b"stts" + bytes(4) + entries + b"".join(table)
    filler = (end - start - len(times)).to_bytes(4, "big") + b"free"
    return data[:start] + (times + filler).ljust(end - start, b"\0") + data[end:]


def test_where_the_rate_varies_frames_have_the_times_of_the_decoder(flight):
    flight.write_bytes(unsteady(flight.read_bytes()))
    sequence = open_sequence(flight)
    half = FRAMES // 2
    np.testing.assert_allclose(sequence.stamps, [*0.02 * np.arange(half), *half * 0.02 + 0.04 * np.arange(half)])
    assert sequence.notes == ("the frame rate varies: 20 to 40 ms between frames",)
    for start in (0, 90, 150, 200, FRAMES - 1):
        assert number_of(open_sequence(flight, frames=f"{start}:").load(0)) == start


def test_a_file_that_has_changed_is_decoded_again(flight):
    open_sequence(flight)
    flight.write_bytes(unsteady(flight.read_bytes()) + b"\0" * 8)
    assert open_sequence(flight).stamps[1] == pytest.approx(0.02)


def test_slices_and_strides(flight):
    sequence = open_sequence(flight, frames="20:30", stride=3)
    assert [number_of(frame.image) for frame in sequence] == [20, 23, 26, 29]


def test_beyond_the_end_is_no_image(flight):
    load = read(flight).load
    assert load(FRAMES) is None and load(FRAMES + 1000) is None
    assert number_of(load(1)) == 1


def test_a_video_that_was_cut_off_is_counted(tmp_path):
    writer = write_video(tmp_path / "whole.mkv")
    shutil.copy(tmp_path / "whole.mkv", tmp_path / "cut.mkv")  # before the length is written into it
    writer.release()
    (tmp_path / "cut.yaml").write_text(CAMERA)
    sequence = open_sequence(tmp_path / "cut.mkv")
    assert 10 < len(sequence) < FRAMES
    assert [number_of(sequence.load(number)) for number in (7, 8, 2)] == [7, 8, 2]


def test_fewer_frames_than_the_header_says(tmp_path):
    path = tmp_path / "cut.avi"
    write_video(path).release()
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    (tmp_path / "cut.yaml").write_text(CAMERA)
    sequence = open_sequence(path)
    assert 60 < len(sequence) < 180
    np.testing.assert_allclose(sequence.stamps, np.arange(len(sequence)) / 25)
    assert sequence.notes == (f"the file says {FRAMES} frames, {len(sequence)} of them can be decoded",)
    assert number_of(sequence.load(50)) == 50


def test_calibration_of_the_same_name_comes_first(flight):
    flight.with_suffix(".yaml").write_text(CAMERA.replace("50", "55"))
    assert open_sequence(flight).camera.fx == 55


def test_distortion_is_removed(flight):
    flight.with_suffix(".yaml").write_text(CAMERA + "distortion_coefficients: [-0.3, 0.1, 0, 0]\n")
    sequence = open_sequence(flight)
    assert sequence.camera.coefficients == () and sequence.load(3).shape == (48, 64)
    assert not np.array_equal(sequence.load(3), open_sequence_without_distortion(flight).load(3))


def open_sequence_without_distortion(flight):
    flight.with_suffix(".yaml").write_text(CAMERA)
    return open_sequence(flight)


def test_errors(flight):
    calibration = flight.parent / "camera.yaml"
    calibration.write_text(CAMERA.replace("64", "128"))
    with pytest.raises(CameraError, match=r"flight\.mp4 is 64x48 pixels, but .*camera\.yaml is for 128x48"):
        open_sequence(flight)
    calibration.unlink()
    with pytest.raises(
        CameraError,
        match=r"flight\.mp4 has no calibration beside it: .* or give the field of view \(--fov DEGREES\)",
    ):
        open_sequence(flight)
    calibration.write_text(CAMERA)
    flight.write_bytes(b"this is no video")
    with pytest.raises(SequenceError, match=r"flight\.mp4 cannot be decoded as a video"):
        open_sequence(flight)


def test_times_and_heights_beside_it(flight):
    times = flight.parent / "times.csv"
    rows = [f"{100 + 0.05 * n:.2f},{5 + 0.1 * n:.1f}\n" for n in range(FRAMES)]
    times.write_text("timestamp_s,height_m\n" + "".join(rows))
    sequence = open_sequence(flight)
    np.testing.assert_allclose(sequence.stamps, 100 + 0.05 * np.arange(FRAMES))
    np.testing.assert_allclose(sequence.ground.heights, 5 + 0.1 * np.arange(FRAMES))
    assert sequence.ground.source == "times.csv height_m" and sequence.notes == ()
    times.write_text("timestamp_s\n" + "".join(f"{n}\n" for n in range(FRAMES + 1)))
    assert open_sequence(flight).notes == (f"times.csv has {FRAMES + 1} rows, of which the first {FRAMES} are used",)
    times.write_text("timestamp_s\n0\n1\n")
    with pytest.raises(SequenceError, match=rf"times\.csv has 2 rows, but the video has {FRAMES} frames: complete it"):
        open_sequence(flight)
    times.write_text("stamp\n0\n1\n")
    with pytest.raises(SequenceError, match=r"times\.csv should have a header with timestamp_s, and a row for each"):
        open_sequence(flight)


def test_a_field_of_view_instead_of_a_calibration(flight):
    (flight.parent / "camera.yaml").unlink()
    camera = open_sequence(flight, fov=90).camera
    assert camera.fx == camera.fy == pytest.approx(32) and (camera.cx, camera.cy) == (31.5, 23.5)
    assert open_sequence(flight, fov=90).notes == (
        "the camera is one whose image is 90 degrees wide, without distortion",
    )
    with pytest.raises(CameraError, match="the field of view must be 5 to 175 degrees from side to side, not 200"):
        open_sequence(flight, fov=200)
    with pytest.raises(SequenceError, match="a field of view is for videos; synthetic:uav has a calibration"):
        open_sequence("synthetic:uav", fov=90)
