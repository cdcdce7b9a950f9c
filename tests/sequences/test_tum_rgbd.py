import numpy as np
import pytest

from fvslam_graph.core.errors import CameraError, SequenceError, TrajectoryError
from fvslam_graph.sequences.open import open_sequence

STAMPS = (1305031102.1753, 1305031102.2113, 1305031102.2432)
TRUTH = "# timestamp tx ty tz qx qy qz qw\n1305031102.1 1 2 3 0 0 0 1\n1305031102.3 1 2 4 0 0 0.7071068 0.7071068\n"


@pytest.fixture
def recording(tmp_path, write_images):
    folder = tmp_path / "rgbd_dataset_freiburg2_desk"
    paths = write_images(folder / "rgb", [f"{stamp:.6f}.png" for stamp in STAMPS], (640, 480))
    rows = [f"{stamp:.6f} rgb/{path.name}\n" for stamp, path in zip(STAMPS, paths, strict=True)]
    (folder / "rgb.txt").write_text("# color images\n# timestamp filename\n" + "".join(rows))
    (folder / "groundtruth.txt").write_text(TRUTH)
    return folder


def test_everything_is_read(recording):
    sequence = open_sequence(recording)
    assert (sequence.name, sequence.format, len(sequence)) == (recording.name, "tum-rgbd", 3)
    np.testing.assert_allclose(sequence.stamps, STAMPS, rtol=0, atol=1e-6)
    assert (sequence.camera.fx, sequence.camera.coefficients) == (520.9, ())
    np.testing.assert_allclose(sequence.ground_truth.positions, [[1, 2, 3], [1, 2, 4]])
    assert sequence.frame(2).image.shape == (480, 640)


def test_freiburg3_is_not_rectified_again(recording):
    third = recording.rename(recording.with_name("rgbd_dataset_freiburg3_long_office"))
    assert [int(frame.image[0, 0]) for frame in open_sequence(third)] == [0, 10, 20]


def test_own_calibration_comes_first(recording):
    text = "image_width: 640\nimage_height: 480\ncamera_matrix: [500, 0, 320, 0, 500, 240, 0, 0, 1]\n"
    (recording / "camera.yaml").write_text(text)
    sequence = open_sequence(recording)
    assert sequence.camera.fx == 500 and sequence.load(1)[0, 0] == 10


def test_unknown_camera(recording):
    other = recording.rename(recording.with_name("my_desk"))
    with pytest.raises(CameraError, match=r"my_desk has no camera\.yaml, and its name does not say"):
        open_sequence(other)


def test_size_mismatch_names_the_published_calibration(recording, write_images):
    write_images(recording / "rgb", [f"{stamp:.6f}.png" for stamp in STAMPS])
    with pytest.raises(CameraError, match="is 64x48 pixels, but the published calibration of freiburg2 is for 640x480"):
        open_sequence(recording)


@pytest.mark.parametrize(
    ("file", "text", "error", "complaint"),
    [
        ("rgb.txt", "# nothing\n", SequenceError, r"rgb\.txt should list the images"),
        ("rgb.txt", "1.0 a.png\n0.5 b.png\n", SequenceError, r"rgb\.txt: stamp 2 of 2 is not later"),
        ("rgb.txt", "noon a.png\n", SequenceError, r"rgb\.txt: row 1 is not numbers"),
        ("groundtruth.txt", "1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", TrajectoryError, r"groundtruth\.txt: .*not later"),
        ("groundtruth.txt", "1 0 0 nan 0 0 0 1\n", TrajectoryError, r"groundtruth\.txt: .*not finite"),
    ],
)
def test_bad_files(recording, file, text, error, complaint):
    (recording / file).write_text(text)
    with pytest.raises(error, match=complaint):
        open_sequence(recording)


@pytest.mark.parametrize(
    "form",
    [
        "{stamp:.6f},rgb/{stamp:.6f}.png",
        "{stamp:.6f} rgb/{stamp:.6f}.png {stamp:.6f} depth/{stamp:.6f}.png",
        "5.0 depth/{stamp:.6f}.png {stamp:.6f} rgb/{stamp:.6f}.png",
        "{stamp:.6f};\trgb/{stamp:.6f}.png",
    ],
)
@pytest.mark.parametrize("titles", ["", "# timestamp filename\n", "timestamp,filename\n"])
def test_lists_with_commas_and_with_depth_images(recording, form, titles):
    rows = [form.format(stamp=stamp) for stamp in STAMPS]
    (recording / "rgb.txt").write_text(titles + "\n".join(rows))
    sequence = open_sequence(recording)
    np.testing.assert_allclose(sequence.stamps, STAMPS, rtol=0, atol=1e-6)
    assert sequence.notes == () and sequence.load(2) is not None


def test_a_list_that_was_not_written(recording):
    (recording / "rgb.txt").write_bytes(b"1305031102.1 rgb/a\0b.png\n")
    with pytest.raises(SequenceError, match=r"rgb\.txt cannot be read as text: it holds NUL bytes"):
        open_sequence(recording)
