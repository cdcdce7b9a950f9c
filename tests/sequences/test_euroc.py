import numpy as np
import pytest

from fvslam_graph.core.errors import CameraError, SequenceError, TrajectoryError
from fvslam_graph.sequences.open import open_sequence

# The camera looks along the body's x axis, its image's y axis points down, and it sits 0.1 m ahead of the body.
SENSOR = """\
%YAML:1.0
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0.0, 0.0, 1.0, 0.1,
        -1.0, 0.0, 0.0, 0.0,
         0.0, -1.0, 0.0, 0.0,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [64, 48]
camera_model: pinhole
intrinsics: [50.0, 51.0, 31.5, 23.5] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]
"""
START = 1403715273262142976
# time, position, quaternion (w first), and velocities that are not read; the second row has turned left by 90 degrees
TRUTH = [f"{START},1,2,3,1,0,0,0,9,9,9", f"{START + 10**8},1,2,3,0.70710678,0,0,0.70710678,9,9,9"]


@pytest.fixture
def recording(tmp_path, write_images):
    cam0 = tmp_path / "V9_01" / "mav0" / "cam0"
    names = [f"{START + 50_000_000 * number}.png" for number in range(3)]
    write_images(cam0 / "data", names)
    rows = [f"{name.removesuffix('.png')},{name}\r\n" for name in names]
    (cam0 / "data.csv").write_text("#timestamp [ns],filename\r\n" + "".join(rows))
    (cam0 / "sensor.yaml").write_text(SENSOR)
    truth = cam0.parent / "state_groundtruth_estimate0"
    truth.mkdir()
    (truth / "data.csv").write_text("#time(ns),px,py,pz,qw,qx,qy,qz,vx,vy,vz\n" + "\n".join(TRUTH) + "\n")
    return tmp_path / "V9_01"


@pytest.mark.parametrize("inside", ["", "mav0"])
def test_everything_is_read(recording, inside):
    sequence = open_sequence(recording / inside)
    assert (sequence.name, sequence.format, len(sequence)) == ("V9_01", "euroc", 3)
    np.testing.assert_allclose(sequence.stamps, START / 1e9 + 0.05 * np.arange(3), rtol=0, atol=1e-6)
    assert (sequence.camera.fx, sequence.camera.fy, sequence.camera.coefficients) == (50, 51, ())
    assert all(frame.image.shape == (48, 64) for frame in sequence)


def test_ground_truth_is_brought_from_body_to_camera(recording):
    truth = open_sequence(recording).ground_truth
    np.testing.assert_allclose(truth.positions, [[1.1, 2, 3], [1, 2.1, 3]], atol=1e-7)
    down, forward = truth.matrices[:, :3, 1], truth.matrices[:, :3, 2]
    np.testing.assert_allclose(forward, [[1, 0, 0], [0, 1, 0]], atol=1e-7)
    np.testing.assert_allclose(down, [[0, 0, -1], [0, 0, -1]], atol=1e-7)
    np.testing.assert_allclose(truth.stamps[1] - truth.stamps[0], 0.1, atol=1e-6)


def test_equidistant_and_undistorted_cameras(recording):
    sensor = recording / "mav0" / "cam0" / "sensor.yaml"
    sensor.write_text(SENSOR.replace("radial-tangential", "equidistant"))
    rectified = open_sequence(recording).load(0)
    sensor.write_text(SENSOR.replace("[-0.28, 0.07, 0.0002, 1.8e-05]", "[0, 0, 0, 0]"))
    plain = open_sequence(recording).load(0)
    assert plain[0, 0] == 0 and not np.array_equal(rectified, plain)


def test_without_ground_truth_and_with_a_lost_image(recording):
    (recording / "mav0" / "state_groundtruth_estimate0" / "data.csv").unlink()
    (recording / "mav0" / "cam0" / "data" / f"{START + 50_000_000}.png").unlink()
    sequence = open_sequence(recording)
    assert sequence.ground_truth is None
    assert [frame.image is None for frame in sequence] == [False, True, False]
    assert sequence.notes == ("1 image is missing: frame 1",)


@pytest.mark.parametrize(
    ("file", "old", "new", "error", "complaint"),
    [
        ("cam0/sensor.yaml", "pinhole", "omni", CameraError, r"sensor\.yaml: the camera model 'omni' is not supported"),
        (
            "cam0/sensor.yaml",
            "[64, 48]",
            "[752, 480]",
            CameraError,
            r"is 64x48 pixels, but .*sensor\.yaml is for 752x480",
        ),
        ("cam0/sensor.yaml", "T_BS", "T_SB", CameraError, r"sensor\.yaml has neither 'T_BS' nor"),
        ("cam0/data.csv", f"{START}.png", f"{START}.png,x", SequenceError, r"data\.csv should list the images"),
        ("cam0/data.csv", f"{START},", f"{START}.5,", SequenceError, r"data\.csv has a time stamp that is not whole"),
        ("cam0/data.csv", f"{START},", f"{START + 10**9},", SequenceError, r"data\.csv: stamp 2 of 3 is not later"),
        (
            "state_groundtruth_estimate0/data.csv",
            "1,2,3,1,0",
            "1,2,3,2,0",
            TrajectoryError,
            "length is not 1",
        ),
        ("state_groundtruth_estimate0/data.csv", f"{START},", "2" * 19 + ",", TrajectoryError, "not later"),
        ("state_groundtruth_estimate0/data.csv", TRUTH[0], "1,2", TrajectoryError, "neither a TUM file"),
    ],
)
def test_bad_files(recording, file, old, new, error, complaint):
    path = recording / "mav0" / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(error, match=complaint):
        open_sequence(recording)


def test_missing_listing(recording):
    (recording / "mav0" / "cam0" / "data.csv").unlink()
    with pytest.raises(SequenceError, match=r"cam0/data\.csv is missing"):
        open_sequence(recording)


def test_real_recording(real_data):
    sequence = open_sequence(real_data("euroc_static"))
    assert (len(sequence), sequence.camera.width, sequence.camera.height) == (30, 752, 480)
    assert sequence.frame(29).image.shape == (480, 752)
    # The vehicle stands still; the truth is the estimate of a filter, which creeps a little.
    assert 1e-4 < np.ptp(sequence.ground_truth.positions, axis=0).max() < 0.01


CAMCHAIN = """\
cam0:
  T_cam_imu:
  - [0.0, -1.0, 0.0, 0.0]
  - [0.0, 0.0, -1.0, 0.0]
  - [1.0, 0.0, 0.0, -0.1]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.0034, 0.0007, -0.002, 0.0002]
  distortion_model: equidistant
  intrinsics: [50.0, 51.0, 31.5, 23.5]
  resolution: [64, 48]
  rostopic: /cam0/image_raw
"""


@pytest.mark.parametrize("with_sensor", [True, False])
def test_tum_vi(recording, with_sensor):
    """The same camera on the same body, as TUM-VI publishes it: the motion capture has been brought to the IMU."""
    mav = recording / "mav0"
    (mav / "state_groundtruth_estimate0").rename(mav / "mocap0")
    truth = mav / "mocap0" / "data.csv"
    truth.write_text("\n".join(row.removesuffix(",9,9,9") for row in ["#timestamp [ns], p_RS_R_x [m]", *TRUTH]))
    (recording / "dso").mkdir()
    (recording / "dso" / "camchain.yaml").write_text(CAMCHAIN)
    if not with_sensor:
        (mav / "cam0" / "sensor.yaml").unlink()
    sequence = open_sequence(recording)
    np.testing.assert_allclose(sequence.ground_truth.positions, [[1.1, 2, 3], [1, 2.1, 3]], atol=1e-7)
    np.testing.assert_allclose(sequence.ground_truth.matrices[0, :3, 2], [1, 0, 0], atol=1e-7)
    assert sequence.notes == () and sequence.load(0).shape == (48, 64)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("-1.0, 0.0, 0.0, 0.0,", "0.0, 0.0, 0.0, 0.0,", "the rotation of 'T_BS' is none"),
        ("-1.0, 0.0, 0.0, 0.0,", "1.0, 0.0, 0.0, 0.0,", "the rotation of 'T_BS' is none"),
        ("0.0, 0.0, 0.0, 1.0]", "0.1, 0.0, 0.0, 1.0]", "the last row of 'T_BS' should be 0 0 0 1"),
        ("0.0, 0.0, 1.0, 0.1,", "0.0, 0.0, 1.0,", "'T_BS' should be 16 numbers"),
    ],
)
def test_where_the_camera_cannot_be(recording, old, new, complaint):
    assert old in SENSOR
    (recording / "mav0" / "cam0" / "sensor.yaml").write_text(SENSOR.replace(old, new))
    with pytest.raises(CameraError, match=rf"sensor\.yaml: {complaint}"):
        open_sequence(recording)


def test_seconds_and_huge_numbers_are_no_nanoseconds(recording):
    listing = recording / "mav0" / "cam0" / "data.csv"
    rows = listing.read_text().splitlines()[1:]
    listing.write_text("".join(f"{number},{row.split(',')[1]}\n" for number, row in enumerate(rows)))
    with pytest.raises(
        SequenceError, match=r"data\.csv: stamp 2 of 3 is less than a microsecond later than the one before"
    ):
        open_sequence(recording)
    listing.write_text(f"{'9' * 400},{rows[0].split(',')[1]}\n")
    with pytest.raises(SequenceError, match=r"data\.csv has a time stamp that is not whole nanoseconds"):
        open_sequence(recording)


def test_poses_that_are_unknown_are_left_out_with_a_note(recording):
    truth = recording / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    truth.write_text(truth.read_text().replace(",1,2,3,1,0", ",1,nan,3,1,0"))
    sequence = open_sequence(recording)
    assert sequence.ground_truth.positions == pytest.approx(np.array([[1, 2.1, 3]]))
    assert "data.csv: 1 of 2 poses have a number that is not finite and are left out" in sequence.notes
