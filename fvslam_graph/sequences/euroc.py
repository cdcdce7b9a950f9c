"""EuRoC MAV recordings in the ASL layout: `mav0/cam0`, ground truth of the body brought to the camera by T_BS.

Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 2016.
"""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.errors import CameraError, SequenceError, TrajectoryError
from fvslam_graph.sequences.base import Sequence
from fvslam_graph.sequences.calibration import make_camera, numbers, read_yaml
from fvslam_graph.sequences.files import missing_note, open_images
from fvslam_graph.sequences.tables import make_trajectory, read_table, require_increasing, to_numbers
from fvslam_graph.trajectory import Trajectory, pose_from_matrix

FORMAT = "euroc"
LAYOUT = "mav0/cam0/ with data.csv and sensor.yaml"


def matches(path: Path) -> bool:
    """Whether this is a recording's folder, or its mav0."""
    return (_mav_folder(path) / "cam0").is_dir()


def read(path: Path) -> Sequence:
    """Open a recording; stamps are its own, in seconds since 1970 as a rule."""
    mav = _mav_folder(path)
    listing = mav / "cam0" / "data.csv"
    rows = read_table(listing, ",")
    if not rows or any(len(row) != 2 for row in rows):
        raise SequenceError(f"{listing} should list the images as rows of time stamp and file name")
    paths = [listing.parent / "data" / name for _, name in rows]
    stamps = _seconds(listing, [row[0] for row in rows])
    require_increasing(listing, stamps)

    sensor = mav / "cam0" / "sensor.yaml"
    content = read_yaml(sensor)
    if content.get("camera_model", "pinhole") != "pinhole":
        raise CameraError(f"{sensor}: the camera model '{content['camera_model']}' is not supported, only 'pinhole' is")
    camera = make_camera(
        sensor,
        numbers(sensor, content, "resolution", 2),
        numbers(sensor, content, "intrinsics", 4),
        str(content.get("distortion_model", "none")),
        numbers(sensor, content, "distortion_coefficients") if "distortion_coefficients" in content else (),
    )

    ground_truth = None
    truth = mav / "state_groundtruth_estimate0" / "data.csv"
    if truth.is_file():
        body_T_camera = pose_from_matrix(np.reshape(numbers(sensor, content, "T_BS", 16), (4, 4)))
        ground_truth = _ground_truth(truth, body_T_camera)
    return Sequence(
        name=mav.parent.name if mav.name == "mav0" else mav.name,
        format=FORMAT,
        camera=camera.undistorted(),
        stamps=stamps,
        load=open_images(paths, camera, sensor),
        ground_truth=ground_truth,
        notes=missing_note(paths),
    )


def _mav_folder(path: Path) -> Path:
    return path / "mav0" if (path / "mav0").is_dir() else path


def _ground_truth(path: Path, body_T_camera: gtsam.Pose3) -> Trajectory:
    """world_T_camera from rows of time stamp, position, quaternion (w first) and more that is not used."""
    rows = read_table(path, ",")
    if not rows or any(len(row) < 8 for row in rows):
        raise TrajectoryError(f"{path} should have rows of time stamp, position and quaternion")
    values = to_numbers(path, [row[1:8] for row in rows])
    norms = np.linalg.norm(values[:, 3:], axis=1)
    if np.any(np.abs(norms - 1) > 0.01):
        raise TrajectoryError(
            f"{path}: the quaternion of row {int(np.argmax(np.abs(norms - 1))) + 1} is not of length 1"
        )
    poses = [
        gtsam.Pose3(gtsam.Rot3.Quaternion(*quaternion), position) * body_T_camera
        for position, quaternion in zip(values[:, :3], values[:, 3:] / norms[:, None], strict=True)
    ]
    return make_trajectory(path, _seconds(path, [row[0] for row in rows]), poses)


def _seconds(path: Path, stamps: list[str]) -> NDArray[np.float64]:
    """Nanoseconds as seconds, to the quarter microsecond that a float holds."""
    try:
        return np.array([int(stamp) for stamp in stamps]) / 1e9
    except ValueError as error:
        raise SequenceError(f"{path} has a time stamp that is not whole nanoseconds: {error}") from None
