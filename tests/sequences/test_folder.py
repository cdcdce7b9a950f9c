import os

import numpy as np
import pytest

from fvslam_graph.core.errors import CameraError, FvslamError, SequenceError, TrajectoryError
from fvslam_graph.sequences.open import open_sequence


def test_listed_images_with_heights(plain_folder):
    sequence = open_sequence(plain_folder)
    assert (sequence.name, sequence.format, len(sequence)) == ("flight", "folder", 10)
    np.testing.assert_allclose(sequence.stamps, 0.1 * np.arange(10))
    # On the floor the altimeter says nothing.
    # A reading below the altimeter's smallest step means at most that step.
    np.testing.assert_allclose(sequence.ground.heights, [0.5, *0.5 * np.arange(1, 10)])
    assert sequence.ground.height_sigma == 0.5
    assert sequence.ground.source == "times.csv height_m" and sequence.ground.normal_sigma == 0.3
    assert sequence.frame(0).height == 0.5 and sequence.frame(4).height == 2.0
    assert sequence.ground_truth is None and sequence.notes == ()


def test_empty_and_absent_heights(plain_folder):
    times = plain_folder / "times.csv"
    times.write_text("filename,timestamp_s,height_m\n0.png,0,\n1.png,1,1.5\n")
    np.testing.assert_allclose(open_sequence(plain_folder).ground.heights, [np.nan, 1.5])
    times.write_text("filename,timestamp_s\n0.png,0\n1.png,1\n")
    assert open_sequence(plain_folder).ground is None


def test_without_times_the_rate_is_that_of_the_camera_file_or_30_hz(plain_folder):
    (plain_folder / "times.csv").unlink()
    sequence = open_sequence(plain_folder)
    np.testing.assert_allclose(sequence.stamps, np.arange(10) / 30)
    assert sequence.notes == ("times.csv is missing, the rate is 30 Hz, assumed",)
    with (plain_folder / "camera.yaml").open("a") as file:
        file.write("rate: 20\n")
    sequence = open_sequence(plain_folder)
    np.testing.assert_allclose(sequence.stamps, np.arange(10) / 20)
    assert sequence.notes == ("times.csv is missing, the rate is 20 Hz, as camera.yaml says",)


def test_ground_truth(plain_folder):
    (plain_folder / "groundtruth.tum").write_text("0 0 0 0 0 0 0 1\n1 0 0 5 0 0 0 1\n")
    assert open_sequence(plain_folder).ground_truth.path_length == 5


def test_lost_and_truncated_images_are_frames_without_image(plain_folder):
    (plain_folder / "images" / "3.png").unlink()
    path = plain_folder / "images" / "7.png"
    path.write_bytes(path.read_bytes()[:200])
    sequence = open_sequence(plain_folder)
    assert [frame.index for frame in sequence if frame.image is None] == [3, 7]
    assert sequence.notes == (
        "1 image is missing: frame 3",
        "1 of the 9 images looked at cannot be decoded, such as 7.png",
    )


@pytest.mark.parametrize(
    ("file", "text", "error", "complaint"),
    [
        ("times.csv", "name,time\n0.png,0\n", SequenceError, r"times\.csv should have a header with filename"),
        ("times.csv", "filename,timestamp_s\n", SequenceError, r"times\.csv should have a header"),
        ("times.csv", "", SequenceError, r"times\.csv should have a header"),
        ("times.csv", "filename,timestamp_s\n0.png\n", SequenceError, "row 1 has 1 values, the header has 2"),
        (
            "times.csv",
            "filename,timestamp_s\n0.png,1\n1.png,0\n",
            SequenceError,
            r"times\.csv: stamp 2 of 2 is not later",
        ),
        ("times.csv", "filename,timestamp_s\n0.png,now\n", SequenceError, r"times\.csv: row 1 is not numbers: 'now'"),
        (
            "times.csv",
            "filename,timestamp_s\nx.png,1\n",
            SequenceError,
            r"none of the 1 images can be decoded, .*x\.png",
        ),
        ("groundtruth.tum", "0 0 0 nan 0 0 0 1\n", TrajectoryError, r"groundtruth\.tum: .*not finite"),
        ("groundtruth.tum", "1 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n", TrajectoryError, r"groundtruth\.tum: .*not later"),
        (
            "camera.yaml",
            "rate: 0\n",
            CameraError,
            r"camera\.yaml has none of the keys by which a calibration is known: 'cam0'",
        ),
    ],
)
def test_bad_files(plain_folder, file, text, error, complaint):
    (plain_folder / file).write_text(text)
    with pytest.raises(error, match=complaint):
        open_sequence(plain_folder)


def test_bad_rate_and_no_images(plain_folder):
    (plain_folder / "times.csv").unlink()
    camera = plain_folder / "camera.yaml"
    camera.write_text(camera.read_text() + "rate: -1\n")
    with pytest.raises(SequenceError, match=r"the rate must be 0\.1 to 10000 images a second, not -1"):
        open_sequence(plain_folder)
    for path in (plain_folder / "images").iterdir():
        path.unlink()
    with pytest.raises(SequenceError, match="images holds no images"):
        open_sequence(plain_folder)


def test_real_flight(real_data):
    sequence = open_sequence(real_data("tello/line"))
    assert (len(sequence), len(sequence.ground_truth)) == (211, 211)
    assert sequence.frame(210).image.shape == (720, 960)
    assert sequence.ground.height_sigma == 0.1 and sequence.ground.heights.min() == 0.1


def write_times(folder, stamps, heights=None):
    rows = [f"{n}.png,{stamp},{heights[n] if heights else ''}\n" for n, stamp in enumerate(stamps)]
    (folder / "times.csv").write_text("filename,timestamp_s,height_m\n" + "".join(rows))


STEPS = np.arange(10) * 0.1


@pytest.mark.parametrize(
    ("stamps", "complaint"),
    [
        (1000 * STEPS, r"times\.csv: the stamps make 0\.01 frames a second, .* are they in the right unit"),
        (1305031102175304000 + (1e9 * STEPS).astype(int), r"make 1e-08 frames a second"),
        (1e-9 * STEPS, "stamp 2 of 10 is less than a microsecond later than the one before; are they in the right u"),
        (1e-4 * STEPS, r"make 1e\+05 frames a second"),
        ([0, 0.1, 0.1 + 1e-9, 0.2], "stamp 3 of 4 is less than a microsecond later"),
        ([0, 0.1, "nan", 0.2], "stamp 3 of 4 is not a finite number"),
    ],
)
def test_stamps_that_cannot_be_seconds(plain_folder, stamps, complaint):
    write_times(plain_folder, stamps)
    with pytest.raises(SequenceError, match=complaint):
        open_sequence(plain_folder)


def test_heights_below_zero(plain_folder):
    write_times(plain_folder, STEPS, [-10 - 0.1 * n for n in range(10)])
    with pytest.raises(SequenceError, match=r"times\.csv: 10 of 10 heights are below zero; heights are metres above"):
        open_sequence(plain_folder)
    write_times(plain_folder, STEPS, [-0.2, -0.1, 0, 0.1, 0.2, 0.3, "nan", "inf", "", 0.4])
    sequence = open_sequence(plain_folder)
    np.testing.assert_allclose(sequence.ground.heights, [0.1] * 4 + [0.2, 0.3] + [np.nan] * 3 + [0.4])
    assert sequence.notes == ("2 heights are below zero, taken as 0.1 m",)
    write_times(plain_folder, STEPS, [0.0] * 10)
    sequence = open_sequence(plain_folder)
    note = f"{plain_folder / 'times.csv'}: the heights are zero throughout, and are not used"
    assert sequence.ground is None and sequence.notes == (note,)


def test_names_are_stamps_where_no_rate_is_known(plain_folder):
    (plain_folder / "times.csv").unlink()
    names = ["1305031102.1", "1305031102.15", "1305031102.2"]
    for number in range(10):
        image = plain_folder / "images" / f"{number}.png"
        _ = image.rename(image.with_name(f"{names[number]}.png")) if number < 3 else image.unlink()
    sequence = open_sequence(plain_folder)
    np.testing.assert_allclose(sequence.stamps, np.array(names, float), atol=1e-6)
    assert [int(frame.image[0, 0]) for frame in sequence] == [0, 10, 20]
    assert sequence.notes == ("times.csv is missing, the images' names are taken as stamps in seconds",)
    with (plain_folder / "camera.yaml").open("a") as file:
        file.write("rate: 10\n")
    np.testing.assert_allclose(open_sequence(plain_folder).stamps, [0, 0.1, 0.2])


def test_a_byte_order_mark_and_the_line_ends_of_windows(plain_folder):
    for name in ("times.csv", "camera.yaml"):
        path = plain_folder / name
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert len(open_sequence(plain_folder)) == 10


@pytest.mark.parametrize("name", ["times.csv", "camera.yaml"])
def test_files_that_are_none(plain_folder, name):
    path = plain_folder / name
    path.write_bytes(bytes(path.stat().st_size))
    with pytest.raises(FvslamError, match=rf"{name} cannot be read as text: it holds NUL bytes"):
        open_sequence(plain_folder)
    path.unlink()
    path.mkdir()
    with pytest.raises(FvslamError, match=rf"{name} is a folder, a text file is expected"):
        open_sequence(plain_folder)
    path.rmdir()
    os.mkfifo(path)
    with pytest.raises(FvslamError, match=rf"{name} is no regular file"):
        open_sequence(plain_folder)


def test_what_is_odd_about_a_calibration_is_noted(plain_folder):
    camera = plain_folder / "camera.yaml"
    camera.write_text(camera.read_text().replace("31.5", "10") + "owner: me\n")
    assert open_sequence(plain_folder).notes == (
        "camera.yaml: not understood and left out: owner",
        "the principal point (10, 23.5) is far from the middle of the 64x48 pixels: "
        "is the calibration that of these images?",
    )
    camera.write_text(camera.read_text().replace("50.0", "70").replace("owner: me\n", "").replace(" 10,", " 31.5,"))
    assert open_sequence(plain_folder).notes == (
        "the focal lengths differ much, fx=70, fy=51: is their order fx fy cx cy?",
    )
