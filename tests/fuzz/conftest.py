"""What is fuzzed: the smallest recording of every format, a run, trajectories, settings and a study."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import load_config
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.estimator import estimate
from fvslam_graph.pipeline import run_metadata
from fvslam_graph.runs.run_folder import RunWriter
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.sequences.oxts import EARTH_RADIUS
from fvslam_graph.simulation.synthetic import synthetic_sequence

FRAMES, WIDTH, HEIGHT, FOCAL = 5, 96, 72, 72.0
START = 1_403_715_273_262_142_976  # ns
STAMPS = 0.1 * np.arange(FRAMES)
MATRIX = f"{FOCAL} 0 47.5 0 {FOCAL} 35.5 0 0 1"
PROJECTION = f"{FOCAL} 0 47.5 0 0 {FOCAL} 35.5 0 0 0 1 0"
CAMERA = f"""\
image_width: {WIDTH}
image_height: {HEIGHT}
camera_matrix: [{MATRIX.replace(" ", ", ")}]
distortion_model: radtan
distortion_coefficients: [-0.01, 0.001, 0.0, 0.0]
"""
SENSOR = f"""\
T_BS:
  cols: 4
  rows: 4
  data: [0.0, 0.0, 1.0, 0.1, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
rate_hz: 10
resolution: [{WIDTH}, {HEIGHT}]
camera_model: pinhole
intrinsics: [{FOCAL}, {FOCAL}, 47.5, 35.5]
distortion_model: radial-tangential
distortion_coefficients: [-0.01, 0.001, 0.0, 0.0]
"""
SETTINGS = "mode: vo\nseed: 3\nfeatures:\n  count: 150\nvo:\n  min_inliers: 10\nscale:\n  source: map\n"
STUDY = """\
name: small
sequences:
  - path: absent
    frames: "0:4"
modes: [vo]
seeds: [1]
settings:
  scale.source: map
align: sim3
"""


@pytest.fixture(scope="session")
def originals(tmp_path_factory: pytest.TempPathFactory, write_bag: Callable[..., Path]) -> Path:
    """A folder for each subject."""
    root = tmp_path_factory.mktemp("originals")
    sequence = synthetic_sequence("uav", frames=FRAMES, size=f"{WIDTH}x{HEIGHT}")
    images, truth = [sequence.load(index) for index in range(FRAMES)], sequence.ground_truth

    def pictures(folder: Path, names: list[str]) -> None:
        folder.mkdir(parents=True)
        for name, image in zip(names, images, strict=True):
            assert cv2.imwrite(str(folder / name), image)

    plain = root / "folder"
    pictures(plain / "images", [f"{number}.png" for number in range(FRAMES)])
    rows = [f"{number}.png,{stamp:.3f},{30 + number}\n" for number, stamp in enumerate(STAMPS)]
    write(plain / "times.csv", "filename,timestamp_s,height_m\n" + "".join(rows))
    write(plain / "camera.yaml", CAMERA)
    truth.write_tum(plain / "groundtruth.tum")

    kitti = root / "kitti"
    pictures(kitti / "sequences" / "07" / "image_0", [f"{number:06d}.png" for number in range(FRAMES)])
    write(kitti / "sequences" / "07" / "calib.txt", f"P0: {PROJECTION}\nP1: {PROJECTION}\n")
    write(kitti / "sequences" / "07" / "times.txt", "".join(f"{stamp:e}\n" for stamp in STAMPS))
    (kitti / "poses").mkdir()
    truth.write_kitti(kitti / "poses" / "07.txt")

    date = root / "kitti_raw" / "2011_09_26"
    drive = date / "2011_09_26_drive_0007_sync"
    pictures(drive / "image_00" / "data", [f"{number:010d}.png" for number in range(FRAMES)])
    for folder in ("image_00", "oxts"):
        write(drive / folder / "timestamps.txt", "".join(f"2011-09-26 13:02:{25 + s:012.9f}\n" for s in STAMPS))
    for number, stamp in enumerate(STAMPS):
        latitude = 49 + np.degrees(10 * stamp / EARTH_RADIUS)
        numbers = [latitude, 8.4, 100.0, 0.0, 0.0, np.pi / 2]
        write(drive / "oxts" / "data" / f"{number:010d}.txt", " ".join(f"{n:.12f}" for n in numbers) + " 0" * 24 + "\n")
    unit = "1 0 0 0 1 0 0 0 1"
    rectified = f"S_rect_00: {WIDTH} {HEIGHT}\nR_rect_00: {unit}\nP_rect_00: {PROJECTION}\n"
    raw = f"S_00: {WIDTH} {HEIGHT}\nK_00: {MATRIX}\nD_00: -0.01 0.001 0 0 0\n"
    write(date / "calib_cam_to_cam.txt", f"calib_time: 09-Jan-2012 13:57:47\n{raw}{rectified}")
    write(date / "calib_velo_to_cam.txt", "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 0\n")
    write(date / "calib_imu_to_velo.txt", f"R: {unit}\nT: 0.5 0 0\n")

    karlsruhe = root / "karlsruhe"
    pictures(karlsruhe, [f"I1_{number:06d}.png" for number in range(FRAMES)])
    write(karlsruhe / "calib.txt", f"P1_roi: {PROJECTION}\nP2_roi: {PROJECTION}\n")
    ins = [[1e9 + s, 49 + np.degrees(10 * s / EARTH_RADIUS), 8.4, 100.0, *[0.0] * 5, np.pi / 2] for s in STAMPS]
    write(karlsruhe / "insdata.txt", "".join(" ".join(f"{n:.12f}" for n in row) + "\n" for row in ins))

    cam0 = root / "euroc" / "mav0" / "cam0"
    names = [f"{START + 100_000_000 * number}" for number in range(FRAMES)]
    pictures(cam0 / "data", [f"{name}.png" for name in names])
    write(cam0 / "data.csv", "#timestamp [ns],filename\n" + "".join(f"{name},{name}.png\n" for name in names))
    write(cam0 / "sensor.yaml", SENSOR)
    write(cam0.parent / "state_groundtruth_estimate0" / "data.csv", asl(truth, START))

    tum = root / "tum"
    pictures(tum / "rgb", [f"{1e9 + stamp:.6f}.png" for stamp in STAMPS])
    write(tum / "rgb.txt", "# colour\n" + "".join(f"{1e9 + s:.6f} rgb/{1e9 + s:.6f}.png\n" for s in STAMPS))
    write(tum / "camera.yaml", CAMERA)
    Trajectory(truth.stamps + 1e9, truth.poses).write_tum(tum / "groundtruth.txt")

    video = root / "video"
    video.mkdir()
    writer = cv2.VideoWriter(str(video / "flight.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (WIDTH, HEIGHT))
    for image in images:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    write(video / "camera.yaml", CAMERA)
    cues = (
        f"{number + 1}\n00:00:00,{round(1000 * stamp):03d} --> 00:00:00,{round(1000 * stamp) + 100:03d}\n"
        f"[latitude: 49.1] [longitude: 8.4] [rel_alt: {30 + number}.0 abs_alt: 130.0] "
        f"[gb_yaw: 0.0 gb_pitch: -90.0 gb_roll: 0.0]\n\n"
        for number, stamp in enumerate(STAMPS)
    )
    write(video / "flight.srt", "".join(cues))

    for name in ("ros1/flight.bag", "mcap/flight.mcap", "sqlite/flight.db3"):
        (root / name).parent.mkdir()
        write_bag(root / name, messages(images, truth))

    trajectories = root / "trajectories"
    trajectories.mkdir()
    exact, noisy = flight(np.zeros(3)), flight(np.array([0.1, 0.02, 0.05]))
    exact.write_tum(trajectories / "reference.tum")
    noisy.write_tum(trajectories / "estimate.tum")
    noisy.write_kitti(trajectories / "estimate.kitti")
    write(trajectories / "reference.csv", asl(exact, 0))

    shutil.copytree(plain, root / "settings" / "recording")
    write(root / "settings" / "config.yaml", SETTINGS)
    shutil.copytree(plain, root / "study" / "recording")
    write(root / "study" / "study.yaml", STUDY)

    finished = root / "run" / "run"
    recording, config = open_sequence(plain), load_config(settings=["mode=graph", "scale.source=map"])
    with RunWriter(finished, config, run_metadata(recording, config), recording.ground_truth) as writer:
        for result in estimate(recording, config):
            writer.add(result)
    return root


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def messages(images: list[np.ndarray], truth: Trajectory) -> Iterator[tuple[str, str, int, dict[str, Any]]]:
    """A bag's: camera_info, images, odometry and heights."""
    for number, image in enumerate(images):
        stamp, q = START + 100_000_000 * number, truth.poses[number].rotation().toQuaternion()
        header = {"header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": "camera"}}
        size = {"width": WIDTH, "height": HEIGHT}
        lens = {"k": np.array(MATRIX.split(), float), "distortion_model": "plumb_bob", "d": [-0.01, 0.001, 0, 0, 0]}
        yield "/camera_info", "sensor_msgs/msg/CameraInfo", stamp, header | size | lens
        raw = {"encoding": "mono8", "step": WIDTH, "data": image.ravel()}
        yield "/image_raw", "sensor_msgs/msg/Image", stamp, header | size | raw
        position = dict(zip("xyz", truth.positions[number], strict=True))
        pose = {"position": position, "orientation": {"x": q.x(), "y": q.y(), "z": q.z(), "w": q.w()}}
        yield "/odom", "nav_msgs/msg/Odometry", stamp, header | {"child_frame_id": "camera", "pose": {"pose": pose}}
        yield "/height", "sensor_msgs/msg/Range", stamp, header | {"range": 30.0 + number, "max_range": 99.0}


def flight(noise: np.ndarray) -> Trajectory:
    """Twenty poses of a curve, some metres a second; the noise repeats every third pose."""
    stamps = 100 + 0.1 * np.arange(20)
    steps = noise[np.arange(20) % 3]
    positions = np.column_stack([3 * np.sin(stamps), 2 * np.cos(stamps) + steps, 0.5 * stamps])
    poses = (gtsam.Pose3(gtsam.Rot3.Rz(0.3 * t + s), p) for t, s, p in zip(stamps, steps, positions, strict=True))
    return Trajectory(stamps, tuple(poses))


def asl(trajectory: Trajectory, start: int) -> str:
    """A table of EuRoC's kind, w first."""
    rows = ["#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"]
    for stamp, pose in zip(trajectory.stamps, trajectory.poses, strict=True):
        q = pose.rotation().toQuaternion()
        numbers = (*pose.translation(), q.w(), q.x(), q.y(), q.z())
        rows.append(",".join([str(start + round(1e9 * stamp)), *(f"{number:.9f}" for number in numbers)]))
    return "\n".join(rows) + "\n"
