import cv2
import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Camera, Distortion
from fvslam_graph.core.errors import CameraError, SequenceError, TrajectoryError
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.sequences.oxts import EARTH_RADIUS

LATITUDE, LONGITUDE = 49.0, 8.4
DISTORTION = (-0.35, 0.2, 0.001, -0.001, -0.05)
R_RECT = gtsam.Rot3.RzRyRx(0.02, -0.01, 0.03).matrix()

# Camera 01 sits 0.5 m to the right of camera 00.
CALIBRATION = {
    "calib_time": "09-Jan-2012 13:57:47",
    "S_00": "80 60",
    "K_00": "50 0 40 0 50 30 0 0 1",
    "D_00": " ".join(map(str, DISTORTION)),
    "S_rect_00": "64 48",
    "R_rect_00": "1 0 0 0 1 0 0 0 1",
    "P_rect_00": "45 0 31.5 0 0 45 23.5 0 0 0 1 0",
    "S_rect_01": "64 48",
    "P_rect_01": "45 0 31.5 -22.5 0 45 23.5 0 0 0 1 0",
}
VELO_TO_CAM = "calib_time: 15-Mar-2012 11:37:16\nR: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 0\n"
IMU_TO_VELO = "R: 1 0 0 0 1 0 0 0 1\nT: {ahead} 0 0\n"  # the laser sits -ahead metres in front of the IMU


def write_calibration(date, changes=None, ahead=0.0):
    text = "".join(f"{key}: {value}\n" for key, value in (CALIBRATION | (changes or {})).items())
    (date / "calib_cam_to_cam.txt").write_text(text)
    (date / "calib_velo_to_cam.txt").write_text(VELO_TO_CAM)
    (date / "calib_imu_to_velo.txt").write_text(IMU_TO_VELO.format(ahead=ahead))


def packet(east=0.0, north=0.0, altitude=100.0, roll=0.0, pitch=0.0, yaw=0.0):
    """A line of 30 numbers at metres east and north of the start."""
    latitude = LATITUDE + np.degrees(north / EARTH_RADIUS)
    longitude = LONGITUDE + np.degrees(east / (EARTH_RADIUS * np.cos(np.radians(LATITUDE))))
    return " ".join(f"{value:.12f}" for value in (latitude, longitude, altitude, roll, pitch, yaw)) + " 0" * 24 + "\n"


def write_packets(drive, packets, numbers=None, seconds=None):
    data = drive / "oxts" / "data"
    data.mkdir(parents=True)
    for number, text in zip(numbers or range(len(packets)), packets, strict=True):
        (data / f"{number:010d}.txt").write_text(text)
    if seconds is not None:
        write_timestamps(drive / "oxts", seconds)


def write_timestamps(folder, seconds):
    lines = [f"2011-09-26 13:02:{25 + second:012.9f}\n" for second in seconds]
    (folder / "timestamps.txt").write_text("".join(lines))


@pytest.fixture
def drive(tmp_path, write_images):
    """Ten images, 0.1 s apart; a drive to the north-east, one metre an image."""
    date = tmp_path / "2011_09_26"
    drive = date / "2011_09_26_drive_0007_sync"
    write_images(drive / "image_00" / "data", [f"{number:010d}.png" for number in range(10)])
    write_timestamps(drive / "image_00", 0.1 * np.arange(10))
    write_calibration(date)
    step = np.sqrt(0.5)
    packets = [packet(east=step * i, north=step * i, yaw=np.pi / 4) for i in range(10)]
    write_packets(drive, packets, seconds=0.1 * np.arange(10) + 0.004)
    return drive


def test_everything_is_read(drive):
    sequence = open_sequence(drive)
    assert (sequence.name, sequence.format, len(sequence)) == (drive.name, "kitti-raw", 10)
    assert sequence.camera == Camera(64, 48, 45, 45, 31.5, 23.5)
    np.testing.assert_allclose(sequence.stamps, 0.1 * np.arange(10), atol=1e-9)
    np.testing.assert_allclose(sequence.ground_truth.stamps, 0.1 * np.arange(10) + 0.004, atol=1e-9)
    np.testing.assert_array_equal(sequence.ground.heights, 1.65)
    assert [int(frame.image[0, 0]) for frame in sequence] == list(range(0, 100, 10))
    assert sequence.notes == ()


def test_driving_ahead_moves_the_camera_along_its_axis(drive):
    truth = open_sequence(drive).ground_truth
    np.testing.assert_allclose(truth.positions, np.outer(np.arange(10), [0, 0, 1]), atol=1e-5)
    np.testing.assert_allclose(truth.matrices[:, :3, :3], np.tile(np.eye(3), (10, 1, 1)), atol=1e-9)


def replace_packets(drive, packets):
    for path in (drive / "oxts" / "data").iterdir():
        path.unlink()
    (drive / "oxts" / "data").rmdir()
    write_packets(drive, packets, seconds=0.1 * np.arange(len(packets)))


def test_turning_left_swings_the_camera_around_the_imu(drive):
    # The camera is one metre ahead of the IMU, which turns from east to north on the spot.
    write_calibration(drive.parent, ahead=-1.0)
    replace_packets(drive, [packet(yaw=0.0), packet(yaw=np.pi / 2)])
    truth = open_sequence(drive).ground_truth
    np.testing.assert_allclose(truth.positions[1], [-1, 0, -1], atol=1e-9)
    np.testing.assert_allclose(truth.matrices[1, :3, 2], [-1, 0, 0], atol=1e-9)


def test_nose_down_and_left_side_up(drive):
    # The packets' pitch is positive nose down, roll is positive left side up.
    replace_packets(drive, [packet(), packet(pitch=0.1), packet(roll=0.1)])
    rotations = open_sequence(drive).ground_truth.matrices[:, :3, :3]
    np.testing.assert_allclose(rotations[1][:, 2], [0, np.sin(0.1), np.cos(0.1)], atol=1e-9)
    np.testing.assert_allclose(rotations[2][:, 0], [np.cos(0.1), np.sin(0.1), 0], atol=1e-9)  # its right goes down


def test_another_camera_is_shifted_along_the_baseline(drive):
    (drive / "image_00").rename(drive / "image_01")
    replace_packets(drive, [packet(yaw=0.0), packet(yaw=np.pi / 2)])
    sequence = open_sequence(drive)
    assert sequence.notes == ("image_00 is missing, image_01 is used", "8 OXTS packets are missing")
    # 0.5 m to the right of the unit: turning left by 90 degrees about it carries the camera ahead and to the left.
    np.testing.assert_allclose(sequence.ground_truth.positions[1], [-0.5, 0, 0.5], atol=1e-9)


def test_rectification_of_the_reference_camera_turns_the_truth(drive):
    write_calibration(drive.parent, {"R_rect_00": " ".join(f"{value:.12f}" for value in R_RECT.ravel())})
    truth = open_sequence(drive).ground_truth
    np.testing.assert_allclose(truth.positions[9], 9 * R_RECT[:, 2], atol=1e-5)


def test_missing_images_are_gaps_in_time(drive):
    for number in (4, 5, 7):
        (drive / "image_00" / "data" / f"{number:010d}.png").unlink()
    sequence = open_sequence(drive)
    np.testing.assert_allclose(sequence.stamps, [0, 0.1, 0.2, 0.3, 0.6, 0.8, 0.9], atol=1e-9)
    assert sequence.notes == ("3 images are missing: number 4-5, 7",)
    assert len(sequence.ground_truth) == 10


def test_an_empty_line_is_the_stamp_of_a_lost_image(drive):
    (drive / "image_00" / "data" / "0000000004.png").unlink()
    stamps = drive / "image_00" / "timestamps.txt"
    lines = stamps.read_text().splitlines(keepends=True)
    stamps.write_text("".join([*lines[:4], "\n", *lines[5:]]))
    np.testing.assert_allclose(open_sequence(drive).stamps, 0.1 * np.array([0, 1, 2, 3, 5, 6, 7, 8, 9]), atol=1e-9)


def test_repeated_and_late_packets_are_left_out(drive):
    write_timestamps(drive / "oxts", [0, 0.1, 0.1, 0.3, 0.2, 0.5, 0.6, 0.7, 0.8, 0.9])
    sequence = open_sequence(drive)
    np.testing.assert_allclose(sequence.ground_truth.stamps, [0, 0.1, 0.3, 0.5, 0.6, 0.7, 0.8, 0.9], atol=1e-9)
    np.testing.assert_allclose(sequence.ground_truth.positions[:, 2], [0, 1, 3, 5, 6, 7, 8, 9], atol=1e-5)
    assert sequence.notes == ("2 OXTS packets are left out: no stamp later than the one before",)


def test_packets_without_stamps_go_by_number(drive):
    (drive / "oxts" / "timestamps.txt").unlink()
    (drive / "oxts" / "data" / "0000000003.txt").unlink()
    sequence = open_sequence(drive)
    np.testing.assert_allclose(sequence.ground_truth.stamps, 0.1 * np.array([0, 1, 2, 4, 5, 6, 7, 8, 9]), atol=1e-9)
    assert "the stamp of the image of its number" in sequence.notes[0]
    assert sequence.notes[1:] == ("1 OXTS packet is missing",)


def test_without_any_stamps_10_hz_is_assumed(drive):
    (drive / "oxts" / "timestamps.txt").unlink()
    (drive / "image_00" / "timestamps.txt").unlink()
    sequence = open_sequence(drive)
    np.testing.assert_allclose(sequence.stamps, 0.1 * np.arange(10), atol=1e-9)
    np.testing.assert_allclose(sequence.ground_truth.stamps, 0.1 * np.arange(10), atol=1e-9)
    assert sequence.notes[0] == "image_00/timestamps.txt is missing, 10 Hz is assumed"


@pytest.mark.parametrize("stamped", [True, False])
def test_packets_at_another_rate_than_the_images(drive, stamped):
    extract = drive.rename(drive.with_name("2011_09_26_drive_0007_extract"))
    write_calibration(extract.parent, {"S_00": "64 48"})
    seconds = 0.01 * np.arange(91)
    replace_packets(extract, [packet(east=10 * second) for second in seconds])
    write_timestamps(extract / "oxts", seconds)
    if not stamped:
        (extract / "oxts" / "timestamps.txt").unlink()
    sequence = open_sequence(extract)
    at_images = sequence.ground_truth.interpolate(sequence.stamps)
    np.testing.assert_allclose(at_images.positions[:, 2], np.arange(10), atol=1e-5)
    assert len(sequence.notes) == (0 if stamped else 1)


def test_extract_is_rectified(tmp_path):
    """Dots drawn where the camera as built sees points come to where the rectified camera sees them."""
    date = tmp_path / "2011_09_28"
    drive = date / "2011_09_28_drive_0001_extract"
    recorded = Camera(400, 300, 250, 250, 205, 145, Distortion.RADTAN, DISTORTION)
    rectified = Camera(320, 240, 240, 240, 160, 120)
    (drive / "image_00" / "data").mkdir(parents=True)
    write_calibration(
        date,
        {
            "S_00": "400 300",
            "K_00": "250 0 205 0 250 145 0 0 1",
            "S_rect_00": "320 240",
            "R_rect_00": " ".join(f"{value:.12f}" for value in R_RECT.ravel()),
            "P_rect_00": "240 0 160 0 0 240 120 0 0 0 1 0",
        },
    )
    points = np.array([[x, y, 1.0] for x in (-0.5, 0.0, 0.5) for y in (-0.35, 0.35)])  # in the rectified camera
    v, u = np.mgrid[:300, :400]
    dots = [np.exp(-((u - x) ** 2 + (v - y) ** 2) / 8) for x, y in recorded.project(points @ R_RECT)]
    cv2.imwrite(str(drive / "image_00" / "data" / "0000000000.png"), (255 * sum(dots)).astype(np.uint8))

    sequence = open_sequence(drive)
    image = sequence.load(0).astype(float)
    assert sequence.camera == rectified and image.shape == (240, 320)
    errors = []
    for x, y in rectified.project(points):
        window = (slice(round(y) - 9, round(y) + 10), slice(round(x) - 9, round(x) + 10))
        v, u = np.mgrid[window]
        centre = np.array([np.sum(u * image[window]), np.sum(v * image[window])]) / image[window].sum()
        errors.append(np.linalg.norm(centre - (x, y)))
    assert max(errors) < 0.1  # 0.05 pixels measured: a dot is not quite stretched about its centre
    moved = np.linalg.norm(recorded.project(points @ R_RECT) - rectified.project(points), axis=1)
    assert moved.min() > 10


def test_date_with_one_drive_and_with_two(drive, write_images):
    assert len(open_sequence(drive.parent)) == 10
    write_images(drive.parent / "2011_09_26_drive_0008_sync" / "image_00" / "data", ["0000000000.png"])
    with pytest.raises(SequenceError, match="holds 2 drives, give one of them: 2011_09_26_drive_0007_sync, 2011_09_26"):
        open_sequence(drive.parent)


def test_without_oxts_or_its_calibration(drive):
    (drive.parent / "calib_imu_to_velo.txt").unlink()
    sequence = open_sequence(drive)
    assert sequence.ground_truth is None
    assert sequence.notes == ("calib_imu_to_velo.txt missing: the OXTS packets cannot be brought to the camera",)
    (drive / "oxts").rename(drive / "gps")
    assert open_sequence(drive).notes == ()


def test_calibration_for_another_size(drive):
    write_calibration(drive.parent, {"S_rect_00": "1242 375"})
    with pytest.raises(CameraError, match=r"is 64x48 pixels, but .*calib_cam_to_cam\.txt is for 1242x375"):
        open_sequence(drive)
    extract = drive.rename(drive.with_name("2011_09_26_drive_0007_extract"))
    with pytest.raises(CameraError, match=r"is 64x48 pixels, but .*calib_cam_to_cam\.txt is for 80x60"):
        open_sequence(extract)


@pytest.mark.parametrize(
    ("file", "text", "error", "complaint"),
    [
        ("../calib_cam_to_cam.txt", "S_rect_00: 64 48\n", CameraError, "has no line 'P_rect_00:' with 12 numbers"),
        (
            "../calib_velo_to_cam.txt",
            "R: 1 2 3\n",
            CameraError,
            r"calib_velo_to_cam\.txt has no line 'R:' with 9 numbers",
        ),
        ("image_00/timestamps.txt", "yesterday\n", SequenceError, r"timestamps\.txt: line 1 is not a date and time"),
        ("image_00/timestamps.txt", "2011-09-26 13:02:25\n" * 10, SequenceError, "stamp 2 of 10 is not later"),
        ("image_00/timestamps.txt", "2011-09-26 13:02:25\n", SequenceError, "has 1 rows, but .* up to 9"),
        ("oxts/data/0000000003.txt", "49.0 8.4 nan 0 0 0\n", TrajectoryError, r"0000000003\.txt is not an OXTS packet"),
        ("oxts/data/0000000003.txt", "", TrajectoryError, r"0000000003\.txt is not an OXTS packet"),
        ("oxts/timestamps.txt", "now\n", SequenceError, r"oxts/timestamps\.txt: line 1 is not a date"),
    ],
)
def test_bad_files(drive, file, text, error, complaint):
    (drive / file).write_text(text)
    with pytest.raises(error, match=complaint):
        open_sequence(drive)


def test_missing_calibration(drive):
    (drive.parent / "calib_cam_to_cam.txt").unlink()
    with pytest.raises(SequenceError, match=r"calib_cam_to_cam\.txt is missing"):
        open_sequence(drive)


def test_real_drive(real_data):
    sequence = open_sequence(real_data("kitti_raw/2011_09_26"))
    assert (len(sequence), len(sequence.ground_truth)) == (108, 108)
    assert sequence.frame(107).image.shape == (375, 1242)
    truth = sequence.ground_truth
    assert 106.5 < truth.path_length < 107.5
    # The car drives straight on: the camera looks along the motion but for a fraction of a degree.
    motion = np.diff(truth.positions, axis=0)
    motion /= np.linalg.norm(motion, axis=1, keepdims=True)
    along = np.sum(motion * truth.matrices[:-1, :3, 2], axis=1)
    assert 0.9990 < along.min() < 1.0  # 0.99968 measured


def test_real_packets_have_truer_stamps_than_the_images(real_data):
    drive = real_data("kitti_raw/2011_09_26/2011_09_26_drive_0001_sync")
    sequence = open_sequence(drive)
    speed = np.array([float(path.read_text().split()[8]) for path in sorted((drive / "oxts" / "data").iterdir())])
    steps = np.linalg.norm(np.diff(sequence.ground_truth.positions, axis=0), axis=1)
    middle = (speed[1:] + speed[:-1]) / 2

    def error(stamps):
        return np.sqrt(np.mean((steps / np.diff(stamps) - middle) ** 2))

    assert error(sequence.ground_truth.stamps) < 0.1 < 0.3 < error(sequence.stamps)  # 0.06 and 0.46 m/s measured


def test_degrees_that_are_none(drive):
    (drive / "oxts" / "data" / "0000000003.txt").write_text(packet().replace("49.", "149."))
    with pytest.raises(TrajectoryError, match=r"0000000003\.txt: 149, 8\.4 are no degrees of latitude and longitude"):
        open_sequence(drive)


@pytest.mark.parametrize(
    ("file", "old", "new", "complaint"),
    [
        ("calib_velo_to_cam.txt", "0 -1 0 0 0 -1 1 0 0", "0 0 0 0 0 0 0 0 0", "the rotation of 'R' is none"),
        ("calib_velo_to_cam.txt", "0 -1 0 0 0 -1 1 0 0", "0 1 0 0 0 -1 1 0 0", "the rotation of 'R' is none"),
        ("calib_imu_to_velo.txt", "1 0 0 0 1 0 0 0 1", "2 0 0 0 2 0 0 0 2", "the rotation of 'R' is none"),
        ("calib_cam_to_cam.txt", "R_rect_00: 1 0 0", "R_rect_00: 0 0 0", "the rotation of 'R_rect_00' is none"),
        ("calib_cam_to_cam.txt", "23.5 0 0 0 1 0\nS_rect_01", "23.5 0 0 0 0 0\nS_rect_01", "the rows of 'P_rect_00'"),
    ],
)
def test_extrinsics_that_are_none(drive, file, old, new, complaint):
    path = drive.parent / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(CameraError, match=rf"{file}: .*{complaint}"):
        open_sequence(drive)
