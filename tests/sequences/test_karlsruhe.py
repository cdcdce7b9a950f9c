import numpy as np
import pytest

from fvslam_graph.core.errors import CameraError, SequenceError, TrajectoryError
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.sequences.oxts import EARTH_RADIUS

CALIBRATION = "roi: 1 2 3 4\nP1_roi: 50 0 31.5 0 0 50 23.5 0 0 0 1 0\nP2_roi: 50 0 31.5 -25 0 50 23.5 0 0 0 1 0\n"


def ins_data(headings, clockwise_from_north):
    """Rows one metre apart along the heading (anticlockwise from east)."""
    headings = np.asarray(headings, float)
    east, north = (np.concatenate([[0], np.cumsum(f(headings[:-1]))]) for f in (np.cos, np.sin))
    rows = np.zeros((len(headings), 10))
    rows[:, 0] = 1268156203.0 + 0.1 * np.arange(len(headings))
    rows[:, 1] = 49.0 + np.degrees(north / EARTH_RADIUS)
    rows[:, 2] = 8.4 + np.degrees(east / (EARTH_RADIUS * np.cos(np.radians(49.0))))
    rows[:, 3] = 100.0
    rows[:, 9] = np.pi / 2 - headings if clockwise_from_north else headings
    return "".join(" ".join(f"{value:.12f}" for value in row) + "\n" for row in rows)


@pytest.fixture
def recording(tmp_path, write_images):
    folder = tmp_path / "2010_03_09_drive_0019"
    write_images(folder, [f"I{side}_{number:06d}.png" for number in range(6) for side in (1, 2)])
    (folder / "calib.txt").write_text(CALIBRATION)
    return folder


def test_everything_but_ins_data(recording):
    sequence = open_sequence(recording)
    assert (sequence.name, sequence.format, len(sequence)) == (recording.name, "karlsruhe", 6)
    assert (sequence.camera.fx, sequence.camera.cx, sequence.camera.width) == (50, 31.5, 64)
    np.testing.assert_allclose(sequence.stamps, 0.1 * np.arange(6))
    assert sequence.ground_truth is None and sequence.ground is None
    assert sequence.notes == ("insdata.txt is missing, 10 Hz is assumed",)
    assert [int(frame.image[0, 0]) for frame in sequence] == [0, 20, 40, 60, 80, 100]  # the left camera's


@pytest.mark.parametrize("clockwise_from_north", [True, False])
def test_ins_data_becomes_camera_poses(recording, clockwise_from_north):
    # Four metres to the east of north-east, then one to the left of that.
    headings = [0.3, 0.3, 0.3, 0.3, 0.3 + np.pi / 2, 0.3 + np.pi / 2]
    (recording / "insdata.txt").write_text(ins_data(headings, clockwise_from_north))
    sequence = open_sequence(recording)
    truth = sequence.ground_truth
    np.testing.assert_allclose(truth.positions, [[0, 0, z] for z in range(5)] + [[-1, 0, 4]], atol=1e-4)
    np.testing.assert_allclose(truth.matrices[:, :3, 2], [[0, 0, 1]] * 4 + [[-1, 0, 0]] * 2, atol=1e-9)
    np.testing.assert_allclose(truth.matrices[:, :3, 1], [[0, 1, 0]] * 6, atol=1e-9)
    np.testing.assert_allclose(sequence.stamps, 0.1 * np.arange(6), atol=1e-6)
    np.testing.assert_allclose(truth.stamps, sequence.stamps)
    assert sequence.notes == ()


def test_headings_across_the_travel_are_noted(recording):
    text = ins_data([0.0] * 6, False)
    (recording / "insdata.txt").write_text(text.replace("0.000000000000\n", "1.000000000000\n"))
    # Read clockwise from north, a heading of 1 is 0.57 rad from east; the other way it would be 1 rad.
    assert open_sequence(recording).notes == ("headings of insdata.txt differ from the direction of travel by 33 deg",)


def test_standing_still(recording):
    text = ins_data([0.7], False)
    rows = [text.replace("1268156203.0", f"126815620{number}.0") for number in range(6)]
    (recording / "insdata.txt").write_text("".join(rows))
    sequence = open_sequence(recording)
    assert sequence.ground_truth.path_length == 0 and sequence.notes == ()


def test_lost_images_keep_their_number(recording):
    for number in (0, 3):
        (recording / f"I1_{number:06d}.png").unlink()
    (recording / "insdata.txt").write_text(ins_data([0.0] * 6, False))
    sequence = open_sequence(recording)
    np.testing.assert_allclose(sequence.stamps, 0.1 * np.arange(5), atol=1e-6)  # since the first image, number 1
    assert [frame.image is None for frame in sequence] == [False, False, True, False, False]
    assert sequence.notes == ("1 image is missing: frame 2",)


def test_pgm_images(tmp_path, write_images):
    write_images(tmp_path / "pgm", ["I1_000000.pgm", "I1_000001.pgm"])
    (tmp_path / "pgm" / "calib.txt").write_text(CALIBRATION)
    assert [int(frame.image[0, 0]) for frame in open_sequence(tmp_path / "pgm")] == [0, 10]


@pytest.mark.parametrize(
    ("file", "text", "error", "complaint"),
    [
        ("calib.txt", "P0: 1 2\n", CameraError, r"calib\.txt has no line 'P1_roi:' with 12 numbers"),
        ("insdata.txt", "1 2 3\n", TrajectoryError, r"insdata\.txt should have 10 columns .*, not 3"),
        ("insdata.txt", "", TrajectoryError, r"insdata\.txt should have 10 columns .*, not 0"),
        ("insdata.txt", ins_data([0.0] * 5, False), SequenceError, r"insdata\.txt has 5 rows, but .* up to 5"),
        (
            "insdata.txt",
            ins_data([0.0] * 6, False).replace("100.000000000000", "nan", 1),
            TrajectoryError,
            r"insdata\.txt holds a number that is not finite",
        ),
        (
            "insdata.txt",
            ins_data([0.0] * 6, False).replace("100.000000000000", "1e300", 1),
            TrajectoryError,
            r"insdata\.txt has a pose with the number 1e\+300, which is no place in metres",
        ),
        ("insdata.txt", ins_data([0.0], False) * 6, SequenceError, r"insdata\.txt: stamp 2 of 6 is not later"),
    ],
)
def test_bad_files(recording, file, text, error, complaint):
    (recording / file).write_text(text)
    with pytest.raises(error, match=complaint):
        open_sequence(recording)


def test_real_recording(real_data):
    sequence = open_sequence(real_data("karlsruhe_demo"))
    assert (len(sequence), sequence.camera.width, sequence.camera.height) == (7, 1267, 387)
    assert sequence.frame(6).image.shape == (387, 1267)
