import sys
import types
from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.sequences import images
from fvslam_graph.sequences.camera_file import write_camera
from fvslam_graph.sequences.open import FORMATS, open_sequence


def test_frames_and_stride_choose_images_stamps_and_heights(plain_folder):
    sequence = open_sequence(plain_folder, frames="2:9", stride=3)
    np.testing.assert_allclose(sequence.stamps, [0.2, 0.5, 0.8])
    np.testing.assert_allclose(sequence.ground.heights, [1.0, 2.5, 4.0])
    assert [int(frame.image[0, 0]) for frame in sequence] == [20, 50, 80]
    assert [frame.index for frame in sequence] == [0, 1, 2]


@pytest.mark.parametrize(("frames", "count"), [(None, 10), (":", 10), ("4:", 6), (":4", 4), ("-3:", 3), ("8:99", 2)])
def test_open_ended_frames(plain_folder, frames, count):
    assert len(open_sequence(plain_folder, frames=frames)) == count


def test_scale_resizes_images_and_camera(plain_folder):
    sequence = open_sequence(plain_folder, scale=0.5)
    assert (sequence.camera.width, sequence.camera.height, sequence.camera.fx) == (32, 24, 25)
    image = sequence.load(0)
    whole = open_sequence(plain_folder).load(0).astype(float)
    assert image.shape == (24, 32)
    assert abs(image[5, 7] - whole[10:12, 14:16].mean()) <= 0.51


def test_an_image_of_another_size_stays_unusable_when_scaled(plain_folder, write_images):
    write_images(plain_folder / "images", ["3.png"], (80, 60))
    assert open_sequence(plain_folder, scale=0.5).load(3) is None


def test_camera_height_and_pitch(plain_folder):
    ground = open_sequence(plain_folder, camera_height=2.0, camera_pitch=0.1).ground
    np.testing.assert_array_equal(ground.heights, 2.0)
    np.testing.assert_allclose(ground.normal, [0, np.cos(0.1), np.sin(0.1)])
    assert ground.source == "given" and ground.normal_sigma == 0.05

    level = open_sequence(plain_folder, camera_height=2.0).ground
    np.testing.assert_array_equal(level.normal, [0, 1, 0])
    tilted = open_sequence(plain_folder, camera_pitch=1.571, frames="3:").ground
    np.testing.assert_allclose(tilted.normal, [0, 0, 1], atol=1e-3)
    np.testing.assert_allclose(tilted.heights, 0.5 * np.arange(3, 10))


def test_what_a_calibration_has_left(plain_folder):
    """A pixel of the undistorted image shows what the camera as it is has where it projects that ray."""
    plain = open_sequence(plain_folder)
    bent = plain.camera.corrected(np.array([0, 0.1, 0, 0, 0, 0, 0]))
    write_camera(plain_folder / "rest.yaml", bent, np.zeros(8), "hand")
    opened = open_sequence(plain_folder, recalibration=plain_folder / "rest.yaml")
    assert opened.camera == plain.camera and "pixels are moved by up to 2.0, by another" in opened.notes[-1]
    columns = np.tile(3 * np.arange(plain.camera.width, dtype=np.uint8), (plain.camera.height, 1))
    straight = replace(plain, load=lambda _: columns).recalibrated(bent).load(0)
    there = bent.project(plain.camera.rays(np.array([[50.0, 40.0]])))[0]
    assert there[0] > 50.3
    assert abs(straight[40, 50] - 3 * there[0]) <= 1  # grey levels
    with pytest.raises(SequenceError, match="the calibration is of 32x24 images, but flight has 64x48"):
        plain.recalibrated(bent.scaled(0.5))
    with pytest.raises(
        SequenceError, match="by up to 10: it should be that of the images as they are once undistorted"
    ):
        plain.recalibrated(replace(bent, coefficients=(1.0, 0, 0, 0)))


def test_camera_height_where_the_format_knows_none(plain_folder):
    (plain_folder / "times.csv").unlink()
    assert open_sequence(plain_folder).ground is None
    assert open_sequence(plain_folder, camera_height=1.2).frame(3).height == 1.2
    with pytest.raises(SequenceError, match="flight has no ground height: give the camera height along with its pitch"):
        open_sequence(plain_folder, camera_pitch=0.1)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"frames": "100"}, "frames are given as START:STOP, for example 100:350, not '100'"),
        ({"frames": "a:b"}, "not 'a:b'"),
        ({"frames": "20:30"}, "no frame of flight is in 20:30, it has 10"),
        ({"stride": 0}, "the stride must be at least 1, not 0"),
        ({"scale": 0.0}, r"the scale must be in \(0, 1\], not 0"),
        ({"scale": 2.0}, "the scale must be in"),
        ({"camera_height": 0.0}, "the camera height must be a positive number of metres, not 0"),
        ({"camera_height": float("nan")}, "the camera height must be a positive number of metres, not nan"),
        ({"camera_pitch": 10.0}, "the camera pitch must be between -pi/2 and pi/2 radians, not 10"),
        ({"format": "bag"}, "the format 'bag' is not one of kitti-odometry, kitti-raw"),
        ({"format": "euroc"}, r"flight is no recording of a known format; looked for mav0/cam0/ .*\(euroc\)$"),
    ],
)
def test_bad_options(plain_folder, options, complaint):
    with pytest.raises(SequenceError, match=complaint):
        open_sequence(plain_folder, **options)


def test_format_can_be_chosen(plain_folder):
    (plain_folder / "rgb.txt").write_text("# made by a converter\n")
    with pytest.raises(SequenceError, match=r"rgb\.txt should list the images"):
        open_sequence(plain_folder)
    assert open_sequence(plain_folder, format="folder").format == "folder"


def test_wrong_paths(tmp_path):
    with pytest.raises(SequenceError, match="nowhere does not exist"):
        open_sequence(tmp_path / "nowhere")
    with pytest.raises(SequenceError, match="is an empty folder"):
        open_sequence(tmp_path)
    (tmp_path / "notes.txt").write_text("nothing")
    with pytest.raises(SequenceError, match=r"the file .*notes\.txt is no recording of a known format; looked for"):
        open_sequence(tmp_path / "notes.txt")
    with pytest.raises(SequenceError) as error:
        open_sequence(tmp_path)
    assert all(f"({module.FORMAT})" in str(error.value) for module in FORMATS)


def test_relative_paths(plain_folder, monkeypatch):
    monkeypatch.chdir(plain_folder)
    assert open_sequence(".").name == "flight"


def test_a_folder_that_cannot_be_read_is_one_sentence(plain_folder, monkeypatch):
    def refuse(self):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr("pathlib.Path.iterdir", refuse)
    with pytest.raises(SequenceError, match=r"flight cannot be read: .*Permission denied"):
        open_sequence(plain_folder)


def test_synthetic_worlds_are_opened_by_name_and_take_the_same_options(plain_folder, monkeypatch):
    names = []

    def open_synthetic(name):
        names.append(name)
        return open_sequence(plain_folder)

    module = types.SimpleNamespace(open_synthetic=open_synthetic)
    monkeypatch.setitem(sys.modules, "fvslam_graph.simulation.synthetic", module)
    sequence = open_sequence("synthetic:uav?seed=3&frames=60", frames="0:6", stride=2, camera_height=7.0)
    assert names == ["synthetic:uav?seed=3&frames=60"]
    assert len(sequence) == 3 and sequence.frame(0).height == 7.0


def test_images_are_read_one_at_a_time(plain_folder, monkeypatch):
    read = []
    original = images.decode
    monkeypatch.setattr(images, "decode", lambda path: read.append(path.name) or original(path))
    monkeypatch.setattr(images, "IMAGES_LOOKED_AT", 4)
    sequence = open_sequence(plain_folder)
    assert read == ["0.png", "3.png", "6.png", "9.png"]
    frames = iter(sequence)
    next(frames)
    next(frames)
    assert read[4:] == ["0.png", "1.png"]


@pytest.mark.parametrize("path", ["~nobody-of-this-name/flight", "a\0b", "a" * 5000])
def test_paths_that_cannot_be(path):
    with pytest.raises(SequenceError, match=r"cannot be read|does not exist"):
        open_sequence(path)
