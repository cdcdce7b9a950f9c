"""KITTI raw recordings: `*_sync` (rectified) and `*_extract` (as recorded), OXTS packets as ground truth.

Geiger, Lenz, Stiller, Urtasun, "Vision meets Robotics: The KITTI Dataset", IJRR 2013.
"""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera, Rectifier
from fvslam_graph.core.sensors import SensorKind, SensorSeries
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.sequences.calibration import projection_camera
from fvslam_graph.sequences.files import count_of, numbered_images, only_one, ranges
from fvslam_graph.sequences.ground import kitti_ground
from fvslam_graph.sequences.images import ImageFiles
from fvslam_graph.sequences.oxts import packet_poses, read_packets, read_timestamps, seconds_since
from fvslam_graph.sequences.plausibility import make_camera, pinhole, require_rotation, rigid_pose
from fvslam_graph.sequences.tables import (
    CalibrationText,
    even_stamps,
    make_trajectory,
    require_increasing,
    require_rows,
)

FORMAT = "kitti-raw"
LAYOUT = "image_00/data/ of a drive, or a date's folder with calib_cam_to_cam.txt and a drive"

CAMERAS = ("00", "01", "02", "03")  # the left gray one where it is there
RATE = 10.0  # Hz, where there are no timestamps


def matches(path: Path) -> bool:
    """Whether this is a drive's folder, or the folder of a date that holds drives."""
    return bool(_drives(path))


def read(path: Path) -> Sequence:
    """Open a drive, or a date with just one drive; the calibration lies in the date's folder.

    A lost image is a gap in time: the frames are those that exist, each with the stamp of its number.
    """
    drive = only_one(path, _drives(path), "drive")
    which = next(which for which in CAMERAS if (drive / f"image_{which}" / "data").is_dir())

    folder = drive / f"image_{which}"
    files = numbered_images(folder / "data")
    images = ImageFiles(list(files.values()))
    numbers = np.array(list(files))
    origin, stamps, notes = _stamps(folder / "timestamps.txt", numbers)
    lost = sorted(set(range(numbers[0], numbers[-1] + 1)) - set(files))
    if lost:
        notes += (f"{count_of(len(lost), 'image')} missing: number {ranges(lost)}",)
    if which != "00":
        notes += (f"image_00 is missing, image_{which} is used",)

    calibration = CalibrationText(drive.parent / "calib_cam_to_cam.txt")
    camera = projection_camera(calibration, f"P_rect_{which}", calibration.numbers(f"S_rect_{which}", 2).tolist())
    if drive.name.endswith("_extract"):
        recorded = _recorded_camera(calibration, which)
        key = f"R_rect_{which}"
        rotation = require_rotation(calibration.path, key, calibration.numbers(key, 3, 3))
        rectifier = Rectifier(recorded, camera, rotation)
        load = images.loader(recorded, calibration.path, rectifier)
        notes += images.notes(recorded)
    else:
        load = images.loader(camera, calibration.path)
        notes += images.notes(camera)

    camera_T_reference = _camera_T_reference(calibration, which)
    packet_stamps, packets, packet_notes = _packets(drive, origin, stamps)
    ground_truth, truth_notes = _ground_truth(drive, camera_T_reference, packet_stamps, packets)
    fixes = SensorSeries(SensorKind.GNSS, packet_stamps, packets[:, :3], np.full((len(packets), 3), np.nan), "OXTS")
    return Sequence(
        name=drive.name,
        format=FORMAT,
        camera=camera,
        stamps=stamps[numbers],
        load=load,
        ground_truth=ground_truth,
        ground=kitti_ground(len(files)),
        sensors=(fixes,) if len(fixes) else (),
        notes=notes + packet_notes + truth_notes,
    )


def _drives(path: Path) -> list[Path]:
    if any((path / f"image_{which}" / "data").is_dir() for which in CAMERAS):
        return [path]
    return sorted({folder.parent.parent for folder in path.glob("*_drive_*/image_0[0-3]/data")})


def _stamps(path: Path, numbers: NDArray[np.int64]) -> tuple[np.datetime64, NDArray[np.float64], tuple[str, ...]]:
    """The time of the first image, seconds since then of every image number, and notes."""
    if not path.is_file():
        stamps = even_stamps(int(numbers[-1]) + 1, RATE) - numbers[0] / RATE
        return np.datetime64("NaT"), stamps, (f"{path.parent.name}/timestamps.txt is missing, 10 Hz is assumed",)
    times = read_timestamps(path)
    require_rows(path, len(times), int(numbers[-1]))
    stamps = seconds_since(times[numbers[0]], times)
    require_increasing(path, stamps[numbers])
    return times[numbers[0]], stamps, ()


def _recorded_camera(calibration: CalibrationText, which: str) -> Camera:
    """The camera as built."""
    K = calibration.numbers(f"K_{which}", 3, 3)
    size, coefficients = calibration.numbers(f"S_{which}", 2), calibration.numbers(f"D_{which}", 5)
    intrinsics = pinhole(calibration.path, f"K_{which}", K)
    return make_camera(calibration.path, size.tolist(), intrinsics, "radtan", coefficients.tolist())


def _camera_T_reference(calibration: CalibrationText, which: str) -> gtsam.Pose3:
    """From camera 00 as built, which the extrinsics refer to, to the rectified camera."""
    P = calibration.numbers(f"P_rect_{which}", 3, 4)
    # P = K [I | t]: t takes points of the rectified camera 00 to this one, a shift along the stereo baseline.
    shift = np.linalg.solve(P[:, :3], P[:, 3])
    rotation = require_rotation(calibration.path, "R_rect_00", calibration.numbers("R_rect_00", 3, 3))
    return gtsam.Pose3(gtsam.Rot3.ClosestTo(rotation), shift)


def _packets(
    drive: Path, origin: np.datetime64, image_stamps: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[str, ...]]:
    """Stamps (N,) and numbers (N, 6) of the OXTS packets that bring news, see `read_packets`; and notes."""
    files = sorted(file for file in (drive / "oxts" / "data").glob("*.txt") if file.stem.isdigit())
    if not files:
        return np.empty(0), np.empty((0, 6)), ()
    numbers = [int(file.stem) for file in files]
    stamps, notes = _packet_stamps(drive, numbers, origin, image_stamps)
    expected = max(max(numbers) + 1, len(image_stamps) if drive.name.endswith("_sync") else 0)
    if len(files) < expected:
        notes += (f"{count_of(expected - len(files), 'OXTS packet')} missing",)
    # Packets may be logged twice or late. A comparison with the running maximum keeps those that bring news.
    known = np.nan_to_num(stamps, nan=-np.inf)
    news = known > np.maximum.accumulate(np.concatenate([[-np.inf], known[:-1]]))
    if not np.all(news):
        notes += (f"{count_of(int(np.sum(~news)), 'OXTS packet')} left out: no stamp later than the one before",)
    return stamps[news], read_packets([file for file, new in zip(files, news, strict=True) if new]), notes


def _ground_truth(
    drive: Path, camera_T_reference: gtsam.Pose3, stamps: NDArray[np.float64], packets: NDArray[np.float64]
) -> tuple[Trajectory | None, tuple[str, ...]]:
    """world_T_camera from the OXTS packets, the world being the first of these camera frames."""
    if not len(packets):
        return None, ()
    extrinsics = [drive.parent / name for name in ("calib_velo_to_cam.txt", "calib_imu_to_velo.txt")]
    missing = [path.name for path in extrinsics if not path.is_file()]
    if missing:
        return None, (f"{' and '.join(missing)} missing: the OXTS packets cannot be brought to the camera",)
    reference_T_velo, velo_T_imu = map(_rigid, extrinsics)
    imu_T_camera = (camera_T_reference * reference_T_velo * velo_T_imu).inverse()
    poses = [world_T_imu * imu_T_camera for world_T_imu in packet_poses(packets)]
    return make_trajectory(drive / "oxts", stamps, poses).from_origin(), ()


def _packet_stamps(
    drive: Path, numbers: list[int], origin: np.datetime64, image_stamps: NDArray[np.float64]
) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Seconds of each OXTS packet, NaN where unknown, and notes.

    The packets' own stamps are used wherever they exist, in `*_sync` too. There, packet i is the 100 Hz packet nearest
    to image i, up to 5 ms away: on 2011_09_26_drive_0001, the speed from positions and the packets' stamps differs
    from the measured one by 0.06 m/s rms, from positions and image stamps by 0.46 m/s.
    """
    path = drive / "oxts" / "timestamps.txt"
    if path.is_file() and not np.isnat(origin):
        return _by_number(numbers, seconds_since(origin, read_timestamps(path))), ()
    if not drive.name.endswith("_extract") or len(numbers) == len(image_stamps):
        note = "each OXTS packet takes the stamp of the image of its number: they have no stamps in common"
        return _by_number(numbers, image_stamps), (note,)
    first, last = image_stamps[np.isfinite(image_stamps)][[0, -1]]
    note = f"{len(numbers)} OXTS packets are spread evenly over the images: they have no stamps in common"
    return np.linspace(first, last, len(numbers)), (note,)


def _by_number(numbers: list[int], stamps: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([stamps[number] if number < len(stamps) else np.nan for number in numbers])


def _rigid(path: Path) -> gtsam.Pose3:
    calibration = CalibrationText(path)
    R, T = calibration.numbers("R", 3, 3), calibration.numbers("T", 3, 1)
    return rigid_pose(path, "R", np.hstack([R, T]))
