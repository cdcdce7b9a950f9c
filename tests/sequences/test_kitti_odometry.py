import numpy as np
import pytest

from fvslam_graph.core.errors import CameraError, SequenceError, TrajectoryError
from fvslam_graph.sequences import kitti_odometry
from fvslam_graph.sequences.open import open_sequence

P0 = "P0: 50 0 31.5 0 0 50 23.5 0 0 0 1 0\n"


@pytest.fixture
def sequence_folder(tmp_path, write_images):
    """Ten frames along the optical axis, one metre and 0.1 s apart."""
    folder = tmp_path / "dataset" / "sequences" / "07"
    write_images(folder / "image_0", [f"{number:06d}.png" for number in range(10)])
    (folder / "calib.txt").write_text(P0)
    (folder / "times.txt").write_text("".join(f"{0.1 * number:e}\n" for number in range(10)))
    poses = tmp_path / "dataset" / "poses"
    poses.mkdir()
    (poses / "07.txt").write_text("".join(f"1 0 0 0 0 1 0 0 0 0 1 {number}\n" for number in range(10)))
    return folder


def test_everything_is_read(sequence_folder):
    sequence = open_sequence(sequence_folder)
    assert (sequence.name, sequence.format, len(sequence)) == ("07", "kitti-odometry", 10)
    assert (sequence.camera.width, sequence.camera.height, sequence.camera.fx, sequence.camera.cx) == (64, 48, 50, 31.5)
    np.testing.assert_allclose(sequence.stamps, 0.1 * np.arange(10))
    np.testing.assert_allclose(sequence.ground_truth.positions[:, 2], np.arange(10))
    np.testing.assert_array_equal(sequence.ground.heights, 1.65)
    np.testing.assert_array_equal(sequence.ground.normal, [0, 1, 0])
    assert sequence.notes == ()
    assert [int(frame.image[0, 0]) for frame in sequence] == list(range(0, 100, 10))


def test_root_with_one_sequence_and_with_two(sequence_folder, write_images):
    root = sequence_folder.parent.parent
    assert len(open_sequence(root)) == 10
    assert len(open_sequence(sequence_folder.parent)) == 10
    write_images(sequence_folder.parent / "08" / "image_0", ["000000.png"])
    with pytest.raises(SequenceError, match="holds 2 sequences, give one of them: 07, 08"):
        open_sequence(root)


def test_what_may_be_missing(sequence_folder):
    (sequence_folder / "times.txt").unlink()
    (sequence_folder.parent.parent / "poses" / "07.txt").unlink()
    sequence = open_sequence(sequence_folder)
    assert sequence.ground_truth is None
    assert sequence.notes == ("times.txt is missing, 10 Hz is assumed",)
    np.testing.assert_allclose(sequence.stamps, 0.1 * np.arange(10))


def test_part_of_a_sequence_keeps_its_numbers(sequence_folder):
    for number in (0, 1, 5, 9):
        (sequence_folder / "image_0" / f"{number:06d}.png").unlink()
    sequence = open_sequence(sequence_folder)
    np.testing.assert_allclose(sequence.stamps, 0.1 * np.arange(2, 9))
    assert len(sequence.ground_truth) == 10
    assert [frame.image is None for frame in sequence] == [False, False, False, True, False, False, False]
    assert sequence.notes == ("times.txt has 10 stamps, the last image is number 8", "1 image is missing: frame 3")


def test_fewer_and_more_poses_than_stamps(sequence_folder):
    poses = sequence_folder.parent.parent / "poses" / "07.txt"
    lines = poses.read_text().splitlines(keepends=True)
    poses.write_text("".join(lines[:6]))
    sequence = open_sequence(sequence_folder)
    assert len(sequence.ground_truth) == 6 and sequence.notes == ("07.txt has 6 poses for 10 stamps",)
    poses.write_text("".join(lines + lines[:2]))
    sequence = open_sequence(sequence_folder)
    assert len(sequence.ground_truth) == 10 and sequence.notes == ("07.txt has 12 poses for 10 stamps",)


@pytest.mark.parametrize(
    ("file", "text", "error", "complaint"),
    [
        ("calib.txt", "P1: 1 2 3\n", CameraError, r"calib\.txt has no line 'P0:' with 12 numbers"),
        ("calib.txt", P0.replace("31.5", "nan"), CameraError, r"calib\.txt has no line 'P0:' with 12 numbers"),
        ("calib.txt", P0.replace("50", "-50"), CameraError, r"calib\.txt: the focal lengths must be positive"),
        ("times.txt", "0\n0.1\n0.1\n", SequenceError, r"times\.txt: stamp 3 of 3 is not later than the one before"),
        ("times.txt", "0\nnan\n", SequenceError, r"times\.txt: stamp 2 of 2 is not a finite number"),
        ("times.txt", "0\n0.1\n", SequenceError, r"times\.txt has 2 rows, but the images are numbered up to 9"),
        ("times.txt", "0\nsoon\n", SequenceError, r"times\.txt: row 2 is not numbers: 'soon'"),
        ("times.txt", "\n", SequenceError, r"times\.txt holds no stamps"),
        ("../../poses/07.txt", "1 0 0 nan 0 1 0 0 0 0 1 0\n", TrajectoryError, r"07\.txt: .* not finite"),
        ("../../poses/07.txt", "nan 0 0 0 0 1 0 0 0 0 1 0\n", TrajectoryError, r"07\.txt: .* not finite"),
        ("../../poses/07.txt", "1 0 0\n", TrajectoryError, r"07\.txt is neither a TUM file .* nor a KITTI file"),
    ],
)
def test_bad_files(sequence_folder, file, text, error, complaint):
    (sequence_folder / file).write_text(text)
    with pytest.raises(error, match=complaint):
        open_sequence(sequence_folder)


def test_missing_calibration_and_empty_image_folder(sequence_folder):
    (sequence_folder / "calib.txt").unlink()
    with pytest.raises(SequenceError, match=r"calib\.txt is missing"):
        open_sequence(sequence_folder)
    for path in (sequence_folder / "image_0").iterdir():
        path.unlink()
    with pytest.raises(SequenceError, match="image_0 holds no images named 000000"):
        open_sequence(sequence_folder)


def test_matches_looks_for_images_only(tmp_path):
    assert not kitti_odometry.matches(tmp_path)
    (tmp_path / "image_0").mkdir()
    assert kitti_odometry.matches(tmp_path)


def test_real_sequence(real_data):
    sequence = open_sequence(real_data("kitti_odometry"))
    assert (sequence.name, len(sequence), len(sequence.ground_truth)) == ("kitti_odometry", 350, 350)
    assert sequence.frame(349).image.shape == (375, 1242)
    assert 246 < sequence.ground_truth.path_length < 247


def test_colour_images_alone(sequence_folder):
    """The right colour camera sits half a metre to the right of camera 0; where the car turns, it goes another way."""
    (sequence_folder / "image_0").rename(sequence_folder / "image_3")
    (sequence_folder / "calib.txt").write_text(P0 + "P3: 60 0 31.5 -30 0 60 23.5 0 0 0 1 0\n")
    poses = sequence_folder.parent.parent / "poses" / "07.txt"
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n0 0 1 0 0 1 0 0 -1 0 0 5\n" * 5)
    sequence = open_sequence(sequence_folder)
    assert sequence.camera.fx == 60 and sequence.notes == ("image_0 is missing, image_3 is used",)
    # Camera 0 goes five metres ahead and turns right; what was to its right is behind.
    np.testing.assert_allclose(sequence.ground_truth.positions[:2], [[0, 0, 0], [-0.5, 0, 4.5]], atol=1e-12)
    np.testing.assert_allclose(sequence.ground_truth.matrices[1, :3, :3], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    assert len(open_sequence(sequence_folder.parent.parent)) == 10


def test_the_first_image_does_not_decide(sequence_folder, write_images):
    write_images(sequence_folder / "image_0", ["000000.png"], (1, 1))
    sequence = open_sequence(sequence_folder)
    assert (sequence.camera.width, sequence.camera.height) == (64, 48)
    assert [frame.image is None for frame in sequence] == [True, *[False] * 9]
    assert sequence.notes == ("1 of the 10 images looked at are not of 64x48 pixels and left out, such as 000000.png",)
    write_images(sequence_folder / "image_0", [f"{number:06d}.png" for number in range(10)], (1, 1))
    with pytest.raises(CameraError, match=r"calib\.txt: the image size must be 16 to 10000 pixels a side, not 1x1"):
        open_sequence(sequence_folder)


@pytest.mark.parametrize(
    ("row", "complaint"),
    [
        ("50 0 0 0 0 50 0 0 31.5 23.5 1 0", "the rows of 'P0' should be fx 0 cx; 0 fy cy; 0 0 1"),
        ("50 0 31.5 0 0 50 23.5 0 0 0 0 1", "the rows of 'P0' should be"),
        ("1 0 0.5 0 0 1 0.5 0 0 0 1 0", "is it in pixels"),
        ("50 0 100 0 0 50 23.5 0 0 0 1 0", "the principal point"),
    ],
)
def test_matrices_of_no_camera(sequence_folder, row, complaint):
    (sequence_folder / "calib.txt").write_text(f"P0: {row}\n")
    with pytest.raises(CameraError, match=rf"calib\.txt: .*{complaint}"):
        open_sequence(sequence_folder)
