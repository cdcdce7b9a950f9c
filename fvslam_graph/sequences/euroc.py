"""EuRoC MAV and TUM-VI recordings in the ASL layout: `mav0/cam0`, ground truth of the body brought to the camera.

Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 2016.
Schubert et al., "The TUM VI benchmark for evaluating visual-inertial odometry", IROS 2018.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import CameraError, SequenceError
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.core.trajectory_files import Layout
from fvslam_graph.sequences.calibration import read_calibration
from fvslam_graph.sequences.images import ImageFiles
from fvslam_graph.sequences.tables import read_listing, require_increasing

FORMAT = "euroc"
LAYOUT = "mav0/cam0/ with data.csv and sensor.yaml, or dso/camchain.yaml beside mav0/"

CALIBRATIONS = ("mav0/cam0/sensor.yaml", "dso/camchain.yaml")  # the second is TUM-VI's
# The body that the calibration refers to: EuRoC's estimate, TUM-VI's motion capture, which is brought to the IMU.
GROUND_TRUTHS = ("state_groundtruth_estimate0", "mocap0")


def matches(path: Path) -> bool:
    """Whether this is a recording's folder, or its mav0."""
    return (_mav_folder(path) / "cam0").is_dir()


def read(path: Path) -> Sequence:
    """Open a recording; stamps are its own, in seconds since 1970 as a rule."""
    mav = _mav_folder(path)
    listing = mav / "cam0" / "data.csv"
    rows = read_listing(listing, (2,))
    stamps = _seconds(listing, [stamp for stamp, _ in rows])
    require_increasing(listing, stamps)
    images = ImageFiles([listing.parent / "data" / name for _, name in rows])

    candidates = [mav.parent / name for name in CALIBRATIONS] if mav.name == "mav0" else [mav / "cam0" / "sensor.yaml"]
    source = next((file for file in candidates if file.is_file()), candidates[0])
    calibration = read_calibration(source)
    camera = calibration.camera

    ground_truth = None
    truth = next((file for name in GROUND_TRUTHS if (file := mav / name / "data.csv").is_file()), None)
    if truth is not None:
        if calibration.body_T_camera is None:
            raise CameraError(f"{source} has neither 'T_BS' nor 'T_cam_imu', by which {truth} is brought to the camera")
        ground_truth = _ground_truth(truth, calibration.body_T_camera)
    return Sequence(
        name=mav.parent.name if mav.name == "mav0" else mav.name,
        format=FORMAT,
        camera=camera.undistorted(),
        stamps=stamps,
        load=images.loader(camera, source),
        ground_truth=ground_truth,
        notes=calibration.notes + images.notes(camera),
    )


def _mav_folder(path: Path) -> Path:
    return path / "mav0" if (path / "mav0").is_dir() else path


def _ground_truth(path: Path, body_T_camera: gtsam.Pose3) -> Trajectory:
    """world_T_camera from poses of the body."""
    truth = Trajectory.read(path, layout=Layout.ASL)
    return replace(truth, poses=tuple(pose * body_T_camera for pose in truth.poses))


def _seconds(path: Path, stamps: list[str]) -> NDArray[np.float64]:
    """Nanoseconds as seconds, to the quarter microsecond that a float holds."""
    try:
        return np.array([int(stamp) for stamp in stamps], np.int64) / 1e9
    except (ValueError, OverflowError) as error:
        raise SequenceError(f"{path} has a time stamp that is not whole nanoseconds: {error}") from None
