"""ROS bags, written by rosbags' own writers."""

import json
import os
import subprocess
import sys
from typing import NamedTuple

import cv2
import gtsam
import numpy as np
import pytest

from fvslam_graph.core.camera import Distortion
from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import CameraError, FvslamError, SequenceError
from fvslam_graph.core.sensors import SensorKind
from fvslam_graph.estimator import estimate
from fvslam_graph.sequences.open import open_sequence, topics_of

SUFFIXES = (".bag", ".mcap", ".db3")
WIDTH, HEIGHT, FRAMES = 64, 48, 6
START = 1_700_000_000_000_000_000  # ns
K = [50.0, 0, 31.5, 0, 51, 23.5, 0, 0, 1]
IMAGE, INFO, RANGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Range"
TF, ODOMETRY, FIX = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry", "sensor_msgs/msg/NavSatFix"


class Message(NamedTuple):
    topic: str
    type: str
    received: int
    fields: dict


def header(stamp: int, frame: str) -> dict:
    return {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": frame}


def time_of(index: float) -> int:
    return START + round(index * 10**8)


def picture(index: int) -> np.ndarray:
    image = np.random.default_rng(index).integers(0, 256, (HEIGHT, WIDTH), np.uint8)
    image[0, 0] = 10 * index
    return image


def message(topic, type, stamp, frame, late=30_000_000, **fields) -> Message:
    """A message that is received a little after its stamp."""
    return Message(topic, type, stamp + late, {"header": header(stamp, frame), **fields})


def raw(index, image, encoding="mono8", topic="/cam/image_raw", step=0, **more) -> Message:
    rows = np.ascontiguousarray(image).view(np.uint8).reshape(len(image), -1)
    padded = np.pad(rows, ((0, 0), (0, step)), constant_values=7)
    fields = {"height": len(image), "width": image.shape[1], "encoding": encoding, "step": padded.shape[1]}
    stamp = more.pop("stamp", time_of(index))
    return message(topic, IMAGE, stamp, "optical", data=padded.ravel(), **fields, **more)


def images(**options) -> list[Message]:
    return [raw(index, picture(index), **options) for index in range(FRAMES)]


def info(k=K, d=(), model="plumb_bob", topic="/cam/camera_info", **more) -> Message:
    size = {"width": WIDTH, "height": HEIGHT}
    return message(topic, INFO, START, "optical", k=k, d=list(d), distortion_model=model, **size | more)


def vector(xyz) -> dict:
    return dict(zip("xyz", map(float, xyz), strict=True))


def pose_fields(pose: gtsam.Pose3, names=("position", "orientation")) -> dict:
    q = pose.rotation().toQuaternion()
    return {names[0]: vector(pose.translation()), names[1]: {"x": q.x(), "y": q.y(), "z": q.z(), "w": q.w()}}


def transforms(topic, stamp, *edges) -> Message:
    """A TF message with edges (parent, child, pose)."""
    items = [
        {
            "header": header(stamp, parent),
            "child_frame_id": child,
            "transform": pose_fields(pose, ("translation", "rotation")),
        }
        for parent, child, pose in edges
    ]
    return Message(topic, TF, stamp, {"transforms": items})


# The camera looks ahead on a body with x ahead and z up.
BODY_T_CAMERA = gtsam.Pose3(gtsam.Rot3(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])), np.array([0.2, 0.0, 0.1]))
BODY_T_DOWN = gtsam.Pose3(gtsam.Rot3.Ry(np.pi / 2), np.array([0.0, 0.0, -0.05]))  # its x axis points down


def body_pose(index: float) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3.Rz(0.1 * index), np.array([index, 0.5 * index, 2.0]))


def mounting() -> Message:
    lens = ("base_link", "/optical", BODY_T_CAMERA)
    return transforms("/tf_static", START, lens, ("base_link", "down", BODY_T_DOWN))


def written(sequence) -> list[int]:
    """What the first pixels say; -1 for frames without an image."""
    return [-1 if frame.image is None else int(frame.image[0, 0]) for frame in sequence]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_images_camera_and_stamps(tmp_path, write_bag, suffix):
    path = write_bag(tmp_path / f"flight{suffix}", [info(), *images()])
    for opened in {path, *path.parent.rglob(f"*{suffix}")}:
        sequence = open_sequence(opened)
        assert (sequence.name, sequence.format) == ("flight", "rosbag")
        np.testing.assert_array_equal(sequence.stamps, [time_of(index) / 1e9 for index in range(FRAMES)])
        camera = sequence.camera
        assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (64, 48, 50, 51, 31.5, 23.5)
        assert camera.distortion is Distortion.NONE
        for index in (3, 0, 5, 5, 1):  # in any order
            np.testing.assert_array_equal(sequence.load(index), picture(index))
        assert sequence.ground_truth is None and sequence.ground is None and sequence.sensors == ()
        assert sequence.notes == ()


def test_topics_are_listed_and_chosen(tmp_path, write_bag, fvslam):
    left = images(topic="/left/image_raw")
    right = [raw(index, 255 - picture(index), topic="/right/image_raw") for index in range(FRAMES)]
    infos = [info(topic="/left/camera_info"), info(topic="/right/camera_info", k=[40.0, *K[1:]])]
    path = write_bag(tmp_path / "stereo.mcap", [*left, *right, *infos])
    assert [(topic.name, topic.count) for topic in topics_of(path)] == [
        ("/left/camera_info", 1),
        ("/left/image_raw", FRAMES),
        ("/right/camera_info", 1),
        ("/right/image_raw", FRAMES),
    ]
    with pytest.raises(
        SequenceError, match=r"2 image topics, choose one by --topic: /left/image_raw, /right/image_raw"
    ):
        open_sequence(path)
    with pytest.raises(SequenceError, match=r"no image topic '/up'; there are /left/image_raw, /right/image_raw"):
        open_sequence(path, topic="/up")
    sequence = open_sequence(path, topic="right/image_raw")
    assert sequence.camera.fx == 40 and written(sequence) == [255 - 10 * index for index in range(FRAMES)]

    code, out, err = fvslam("info", path)
    assert code == 1 and f"/left/image_raw: {FRAMES} {IMAGE}" in out and err.startswith("fvslam: ")
    code, out, _ = fvslam("info", path, "--topic", "/left/image_raw")
    assert code == 0 and f"/right/image_raw: {FRAMES} {IMAGE}" in out and "fx 50.00" in out
    options = ("--topic", "/left/image_raw", "--set", "scale.source=map", "--out", tmp_path / "run")
    assert fvslam("run", path, *options).code == 0
    options = ("--topic", "/left/image_raw", "--modes", "vo", "--seeds", "1", "--out", tmp_path / "comparison")
    assert fvslam("compare", path, *options).code == 0


def test_only_bags_have_topics(plain_folder):
    with pytest.raises(SequenceError, match="flight is no bag, and has no topic 'x'"):
        open_sequence(plain_folder, topic="x")
    with pytest.raises(SequenceError, match="synthetic:uav is no bag"):
        open_sequence("synthetic:uav", topic="x")


COLOUR = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 4), np.uint8)


@pytest.mark.parametrize(
    ("encoding", "image", "expected"),
    [
        ("mono8", COLOUR[..., 0], COLOUR[..., 0]),
        ("8UC1", COLOUR[..., 0], COLOUR[..., 0]),
        ("bgr8", COLOUR[..., :3], cv2.cvtColor(COLOUR, cv2.COLOR_BGRA2GRAY)),
        ("rgb8", COLOUR[..., 2::-1], cv2.cvtColor(COLOUR, cv2.COLOR_BGRA2GRAY)),
        ("bgra8", COLOUR, cv2.cvtColor(COLOUR, cv2.COLOR_BGRA2GRAY)),
        ("rgba8", COLOUR[..., [2, 1, 0, 3]], cv2.cvtColor(COLOUR, cv2.COLOR_BGRA2GRAY)),
    ],
)
def test_encodings(tmp_path, write_bag, encoding, image, expected):
    path = write_bag(tmp_path / "x.bag", [info(), raw(0, image, encoding, step=5), raw(1, image, encoding)])
    sequence = open_sequence(path)
    for index in range(2):  # with rows that are longer than the image, and without
        np.testing.assert_array_equal(sequence.load(index), expected)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns(tmp_path, write_bag, pattern):
    """A scene of one colour is the luma of that colour, whatever the pattern."""
    levels = {"r": 200, "g": 100, "b": 20}
    cell = np.array([levels[name] for name in pattern], np.uint8).reshape(2, 2)
    path = write_bag(tmp_path / "x.bag", [info(), raw(0, np.tile(cell, (24, 32)), f"bayer_{pattern}8")])
    luma = 0.299 * 200 + 0.587 * 100 + 0.114 * 20
    np.testing.assert_allclose(open_sequence(path).load(0)[2:-2, 2:-2], luma, atol=1)


@pytest.mark.parametrize("big", [0, 1])
def test_sixteen_bits_are_scaled_to_eight(tmp_path, write_bag, big):
    deep = (picture(0).astype(np.uint16) << 4).astype(">u2" if big else "<u2")  # a camera of 12 bits
    sequence = open_sequence(write_bag(tmp_path / "x.db3", [info(), raw(0, deep, "mono16", is_bigendian=big)]))
    np.testing.assert_array_equal(sequence.load(0), picture(0))
    assert any("taken as 12 bits" in note for note in sequence.notes)


@pytest.mark.parametrize(("suffix", "exact"), [(".png", True), (".jpg", False)])
def test_compressed_images(tmp_path, write_bag, suffix, exact):
    topic = "/cam/image_raw/compressed"
    data = [cv2.imencode(suffix, picture(index))[1] for index in range(FRAMES)]
    data[2] = data[2][:300]  # cut off
    messages = [
        message(topic, "sensor_msgs/msg/CompressedImage", time_of(index), "optical", format="x", data=item)
        for index, item in enumerate(data)
    ]
    sequence = open_sequence(write_bag(tmp_path / "x.mcap", [info(), *messages]))
    assert sequence.load(2) is None and any(
        "1 of the 6 images looked at cannot be decoded" in n for n in sequence.notes
    )
    expected = cv2.imdecode(data[4], cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(sequence.load(4), expected)
    assert np.array_equal(expected, picture(4)) is exact


def test_images_that_are_not_usable_are_frames_without_one(tmp_path, write_bag):
    short = raw(1, picture(1))
    short.fields["data"] = short.fields["data"][:100]
    messages = [raw(0, picture(0)), short, raw(2, picture(2)[:40]), raw(3, picture(3), "yuv422"), raw(4, picture(4))]
    sequence = open_sequence(write_bag(tmp_path / "x.bag", [info(), *messages]))
    assert written(sequence) == [0, -1, -1, -1, 40]
    assert any("such as that of 1700000000.200 s" in note for note in sequence.notes)
    with pytest.raises(SequenceError, match="has the encoding 'yuv422'; read are mono8"):
        open_sequence(write_bag(tmp_path / "y.bag", [info(), raw(0, picture(0), "yuv422")]))
    with pytest.raises(CameraError, match=r"is 64x40 pixels, but .*camera_info is for 64x48"):
        open_sequence(write_bag(tmp_path / "z.bag", [info(), raw(0, picture(0)[:40])]))


def test_stamps_out_of_order_repeated_and_not_set(tmp_path, write_bag):
    stamps = [0, 2, 1, 3, 3, 4]
    messages = [raw(index, picture(index), stamp=time_of(stamp)) for index, stamp in enumerate(stamps)]
    received = [item._replace(received=time_of(index)) for index, item in enumerate(messages)]
    sequence = open_sequence(write_bag(tmp_path / "x.mcap", [info(), *received]))
    np.testing.assert_array_equal(sequence.stamps, [time_of(index) / 1e9 for index in range(5)])
    assert written(sequence) == [0, 20, 10, 30, 50]
    assert sequence.notes == (
        "1 image is older than the one before: they are sorted by their stamps",
        "1 image is of the same stamp as another and left out",
    )

    unset = [raw(index, picture(index), stamp=0)._replace(received=time_of(index)) for index in range(FRAMES)]
    sequence = open_sequence(write_bag(tmp_path / "y.bag", [info(), *unset]))
    np.testing.assert_array_equal(sequence.stamps, [time_of(index) / 1e9 for index in range(FRAMES)])
    assert written(sequence) == [10 * index for index in range(FRAMES)]
    assert sequence.notes == ("/cam/image_raw has no stamps: the times of receipt are taken",)

    sequence = open_sequence(write_bag(tmp_path / "z.bag", [info(), unset[0], *received[1:3]]))
    assert len(sequence) == 2 and "1 image is without a stamp and left out" in sequence.notes


def test_images_received_at_once(tmp_path, write_bag):
    """A recorder that was busy writes several at the same time."""
    at_once = [item._replace(received=START + 10**9) for item in images()]
    for name in ("x.bag", "y.mcap", "z.db3"):
        assert written(open_sequence(write_bag(tmp_path / name, [info(), *at_once]))) == [0, 10, 20, 30, 40, 50]


@pytest.mark.parametrize(
    ("model", "coefficients", "distortion"),
    [
        ("plumb_bob", (-0.1, 0.01, 0, 0, 0), Distortion.RADTAN),
        ("rational_polynomial", (-0.1, 0.01, 0, 0, 0, 0.01, 0, 0), Distortion.RATIONAL),
        ("equidistant", (-0.1, 0.01, 0, 0), Distortion.EQUIDISTANT),
        ("plumb_bob", (), Distortion.NONE),
        ("", (), Distortion.NONE),
    ],
)
def test_lenses(tmp_path, write_bag, plain_folder, model, coefficients, distortion):
    """As a folder with the same camera rectifies them."""
    path = write_bag(tmp_path / "x.bag", [info(d=coefficients, model=model), *images()])
    camera = plain_folder / "camera.yaml"
    lens = f"distortion_model: {model or 'none'}\ndistortion_coefficients: {list(coefficients)}\n"
    text = camera.read_text().partition("distortion_model")[0]
    camera.write_text(text + (lens if distortion is not Distortion.NONE else "distortion_model: none\n"))
    for index in range(FRAMES):
        assert cv2.imwrite(str(plain_folder / "images" / f"{index}.png"), picture(index))
    folder, bag = open_sequence(plain_folder), open_sequence(path)
    assert bag.camera == folder.camera
    np.testing.assert_array_equal(bag.load(2), folder.load(2))


def test_a_camera_file_beside_the_bag(tmp_path, write_bag, plain_folder):
    path = write_bag(tmp_path / "x.bag", images())
    with pytest.raises(
        CameraError, match=r"has no camera_info of /cam/image_raw: write x\.yaml or camera\.yaml beside"
    ):
        open_sequence(path)
    text = (plain_folder / "camera.yaml").read_text()
    (tmp_path / "x.yaml").write_text(text)
    assert open_sequence(path).camera.fx == 50
    path = write_bag(tmp_path / "y.mcap", [info(k=9 * [0.0]), *images()])
    with pytest.raises(CameraError, match=r"y/cam/camera_info is of a camera that is not calibrated, K is zero"):
        open_sequence(path)
    (path / "camera.yaml").write_text(text)
    assert open_sequence(path).notes == ("/cam/camera_info is not calibrated, camera.yaml is taken",)
    path = write_bag(tmp_path / "z.bag", [info(k=[60.0, *K[1:]]), *images()])
    (tmp_path / "z.yaml").write_text(text)
    sequence = open_sequence(path)
    assert sequence.camera.fx == 60
    assert sequence.notes == ("z.yaml is left out, as /cam/camera_info has the calibration",)
    with pytest.raises(CameraError, match=r"camera_info: 'binning' and 'roi' are not supported"):
        open_sequence(write_bag(tmp_path / "w.bag", [info(binning_x=2), *images()]))


def assert_camera_poses(truth, indices) -> None:
    assert len(truth) == len(indices)
    for index, stamp, pose in zip(indices, truth.stamps, truth.poses, strict=True):
        assert stamp == time_of(index) / 1e9
        assert pose.equals(body_pose(index) * BODY_T_CAMERA, 1e-9)


INDICES = [0, 0.5, 1, 2, 3, 4, 5]


def odometry(topic="/odom", child="base_link") -> list[Message]:
    return [
        message(topic, ODOMETRY, time_of(i), "odom", child_frame_id=child, pose={"pose": pose_fields(body_pose(i))})
        for i in INDICES
    ]


def test_ground_truth_by_odometry(tmp_path, write_bag):
    sequence = open_sequence(write_bag(tmp_path / "x.bag", [info(), mounting(), *images(), *odometry()]))
    assert_camera_poses(sequence.ground_truth, INDICES)
    assert sequence.notes == (f"the ground truth is /odom, {ODOMETRY}",)
    sequence = open_sequence(write_bag(tmp_path / "y.bag", [info(), *images(), *odometry()]))
    assert sequence.ground_truth.poses[3].equals(body_pose(2), 1e-9)
    assert sequence.notes[-1] == "no TF says how the camera sits on the body: their frames are taken as one"
    sequence = open_sequence(write_bag(tmp_path / "z.bag", [info(), *images(), *odometry(child="optical")]))
    assert sequence.ground_truth.poses[3].equals(body_pose(2), 1e-9) and len(sequence.notes) == 1


@pytest.mark.parametrize(
    ("type", "fields"),
    [
        ("geometry_msgs/msg/PoseStamped", lambda pose: {"pose": pose_fields(pose)}),
        ("geometry_msgs/msg/PoseWithCovarianceStamped", lambda pose: {"pose": {"pose": pose_fields(pose)}}),
        (
            "geometry_msgs/msg/TransformStamped",
            lambda pose: {"child_frame_id": "base_link", "transform": pose_fields(pose, ("translation", "rotation"))},
        ),
    ],
)
def test_ground_truth_by_pose_topics(tmp_path, write_bag, type, fields):
    """One that is named after motion capture is preferred; what a pose without a child is of, the tree says."""
    poses = [message("/mocap/drone", type, time_of(i), "world", **fields(body_pose(i))) for i in INDICES]
    goals = [poses[0]._replace(topic="/move_base/goal"), poses[1]._replace(topic="/move_base/goal")]
    bag = [info(), mounting(), *images(), *odometry(), *poses, *goals]
    sequence = open_sequence(write_bag(tmp_path / "x.mcap", bag))
    assert_camera_poses(sequence.ground_truth, INDICES)
    assert sequence.notes == (f"the ground truth is /mocap/drone, {type}; there are also /odom",)


@pytest.mark.parametrize("static", ["/tf_static", "/tf"])
def test_ground_truth_by_tf(tmp_path, write_bag, static):
    """Two edges that move at different rates; what never changes sits fixed, whichever topic says so."""
    odom = gtsam.Pose3(gtsam.Rot3.Rz(0.3), np.array([5.0, 0, 0]))

    def drift(index: float) -> gtsam.Pose3:
        return gtsam.Pose3(gtsam.Rot3(), np.array([0.01 * index, 0, 0]))

    fixed = [mounting()._replace(topic=static, received=time_of(i)) for i in (0, 2, 4)]
    moving = [transforms("/tf", time_of(i), ("odom", "base_link", body_pose(i))) for i in INDICES]
    corrected = [transforms("/tf", time_of(i), ("map", "odom", odom * drift(i))) for i in (0, 1, 5)]
    sequence = open_sequence(write_bag(tmp_path / "x.db3", [info(), *images(), *fixed, *moving, *corrected]))
    for index, pose in zip(INDICES, sequence.ground_truth.poses, strict=True):
        assert pose.equals(odom * drift(index) * body_pose(index) * BODY_T_CAMERA, 1e-7)
    assert "the ground truth is TF, from 'map' to 'optical'" in sequence.notes


def test_frames_in_a_circle_and_poses_that_are_none(tmp_path, write_bag):
    circle = transforms(
        "/tf_static", START, ("optical", "base_link", gtsam.Pose3()), ("base_link", "optical", gtsam.Pose3())
    )
    poses = odometry()
    poses[2].fields["pose"]["pose"]["orientation"] = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}
    poses[4].fields["pose"]["pose"]["position"]["x"] = float("nan")
    sequence = open_sequence(write_bag(tmp_path / "x.bag", [info(), circle, *images(), *poses]))
    assert len(sequence.ground_truth) == len(INDICES) - 2
    assert "2 poses of the ground truth are none, or repeat a stamp, and are left out" in sequence.notes


def ranges(values, topic="/height", frame="down") -> list[Message]:
    limits = {"min_range": 0.0, "max_range": 20.0}
    return [message(topic, RANGE, time_of(i), frame, range=value, **limits) for i, value in enumerate(values)]


def test_a_range_finder_that_looks_down_tells_the_height(tmp_path, write_bag):
    readings = ranges([0.0, 0.1, 0.3, 1.0, float("inf"), 2.0])
    sequence = open_sequence(write_bag(tmp_path / "x.bag", [info(), *images(), *readings]))
    np.testing.assert_array_equal(sequence.ground.heights[[0, 1, 2, 3, 5]], [0.1, 0.1, 0.3, 1, 2])  # no 0.10000000149
    assert sequence.ground.heights[4] == pytest.approx(1.5, abs=1e-5)  # stamps are held to a quarter microsecond
    assert sequence.ground.height_sigma == 0.1 and sequence.ground.source == "/height, looking down"
    assert "/height is taken to look down, as no TF says where it looks" in sequence.notes
    (series,) = sequence.sensors
    assert series.kind is SensorKind.RANGE and series.source == "/height" and len(series) == 5
    np.testing.assert_array_equal(series.values[:, 0], [0, 0.1, 0.3, 1, 2])
    assert np.isnan(series.sigmas).all()


def test_tf_says_which_range_finder_looks_down_and_where_the_camera_is(tmp_path, write_bag):
    ahead = transforms("/tf_static", START, ("base_link", "ahead", gtsam.Pose3()))
    readings = [*ranges(6 * [9.0], "/ahead", "ahead"), *ranges([1.0, 1.5, 2.0, 2.5, 3.0, 3.5])]
    path = write_bag(tmp_path / "x.mcap", [info(), mounting(), ahead, *images(), *readings])
    sequence = open_sequence(path)
    # The camera is 0.15 m above the range finder.
    np.testing.assert_allclose(sequence.ground.heights, np.arange(1.15, 4, 0.5), atol=1e-12)
    np.testing.assert_allclose(sequence.ground.normal, [0, 1, 0], atol=1e-9)
    assert len(sequence.sensors) == 2 and sequence.notes == ()
    two = [*ranges(6 * [9.0], "/a", "a"), *ranges(6 * [1.0], "/b", "b")]
    sequence = open_sequence(write_bag(tmp_path / "y.mcap", [info(), *images(), *two]))
    assert sequence.ground is None
    assert sequence.notes == ("no TF says which range finder looks down: none tells a height above ground",)


def test_other_sensors(tmp_path, write_bag):
    covariance = np.diag([1.0, 4.0, 9.0]).ravel()  # east, north, up
    fixes = [
        message(
            "/fix",
            FIX,
            time_of(i),
            "gps",
            latitude=49.0 + i,
            longitude=8.0,
            altitude=100.0,
            status={"status": 0 if i != 2 else -1},
            position_covariance=covariance,
            position_covariance_type=2 if i else 0,
        )
        for i in range(4)
    ]
    pressure = [
        message("/baro", "sensor_msgs/msg/FluidPressure", time_of(0), "", fluid_pressure=101325.0, variance=4.0)
    ]
    altitude = [message("/altitude", "mavros_msgs/msg/Altitude", time_of(0), "", relative=2.5)]
    path = write_bag(tmp_path / "x.mcap", [info(), *images(), *fixes, *pressure, *altitude])
    by_kind = {series.kind: series for series in open_sequence(path).sensors}
    gnss, baro, height = (by_kind[kind] for kind in (SensorKind.GNSS, SensorKind.PRESSURE, SensorKind.HEIGHT))
    np.testing.assert_array_equal(gnss.values, [[49, 8, 100], [50, 8, 100], [52, 8, 100]])
    np.testing.assert_array_equal(gnss.sigmas, [3 * [np.nan], [2, 1, 3], [2, 1, 3]])  # north, east, up
    assert (baro.values[0, 0], baro.sigmas[0, 0], height.values[0, 0]) == (101325, 2, 2.5)


def test_bags_that_are_damaged(tmp_path, write_bag, fvslam):
    whole = {suffix: write_bag(tmp_path / f"x{suffix.strip('.')}{suffix}", [info(), *images()]) for suffix in SUFFIXES}
    files = {suffix: path if path.is_file() else next(path.glob(f"*{suffix}")) for suffix, path in whole.items()}
    for suffix, file in files.items():
        data = file.read_bytes()
        for kept in (0, 5, len(data) // 2, len(data) - 3):
            file.write_bytes(data[:kept])
            try:
                sequence = open_sequence(whole[suffix])
            except FvslamError as error:
                assert str(tmp_path) in str(error) and "\n" not in str(error)
            else:  # SQLite's pages before the end can still be read
                assert suffix == ".db3" and (sequence.notes or len(sequence) == FRAMES)
        file.write_bytes(data)
    file = files[".bag"]
    data = bytearray(file.read_bytes())
    place = data.index(b"index_pos=") + len(b"index_pos=")
    data[place : place + 8] = bytes(8)
    file.write_bytes(data)
    with pytest.raises(SequenceError, match=r"not indexed.*rosbag reindex"):
        open_sequence(file)
    code, _, err = fvslam("info", file)
    assert code == 1 and err.startswith("fvslam: ") and "Traceback" not in err


def test_what_comes_before_the_damage_is_read(tmp_path, write_bag):
    noisy = [raw(index, np.random.default_rng(index).integers(0, 256, (480, 640), np.uint8)) for index in range(FRAMES)]
    path = write_bag(tmp_path / "x.bag", [info(width=640, height=480, k=[500.0, 0, 320, 0, 500, 240, 0, 0, 1]), *noisy])
    data = path.read_bytes()
    last = data.rindex(noisy[5].fields["data"][:100].tobytes())
    path.write_bytes(data[: last - 150] + bytes(100) + data[last - 50 :])
    sequence = open_sequence(path)
    assert len(sequence) == 5 and sequence.load(4) is not None
    assert any(note.startswith("the bag is damaged, and is read up to") for note in sequence.notes)


def test_bags_without_messages_images_or_metadata(tmp_path, write_bag):
    with pytest.raises(SequenceError, match=r"x\.bag holds no messages"):
        open_sequence(write_bag(tmp_path / "x.bag", []))
    with pytest.raises(SequenceError, match=r"y\.bag holds no images; its topics are /cam/camera_info"):
        open_sequence(write_bag(tmp_path / "y.bag", [info()]))
    path = write_bag(tmp_path / "z.mcap", [info(), *images()])
    (path / "metadata.yaml").unlink()  # a recorder that died has not written it
    assert len(open_sequence(path)) == FRAMES
    (path / "z_1.mcap").write_bytes((path / "z.mcap").read_bytes())
    with pytest.raises(SequenceError, match=r"2 bag files, give one of them: z\.mcap, z_1\.mcap"):
        open_sequence(path)
    os.mkfifo(path / "z_2.mcap")
    with pytest.raises(SequenceError, match=r"z_2\.mcap is no regular file"):
        open_sequence(path)


def test_a_missing_extra_is_one_sentence(tmp_path, write_bag, monkeypatch):
    path = write_bag(tmp_path / "x.bag", [info(), *images()])
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(FvslamError, match=r"rosbags is not installed; `pip install fvslam-graph\[bags\]`"):
        open_sequence(path)


AGAIN = """\
import json, sys
from fvslam_graph.sequences.open import open_sequence
sequence = open_sequence(**json.load(sys.stdin))
print([int(sequence.load(index)[0, 0]) for index in range(len(sequence))])
"""


def test_processes_open_the_bag_again(tmp_path, write_bag):
    sequence = open_sequence(write_bag(tmp_path / "x.mcap", [info(), *images()]), frames="1:5", stride=2)
    assert written(sequence) == [10, 30]
    other = subprocess.run(
        [sys.executable, "-c", AGAIN], input=json.dumps(sequence.source), text=True, stdout=subprocess.PIPE
    )
    assert other.stdout == "[10, 30]\n"


def tello_messages(folder):
    """The recording as a driver publishes it; heights as those of a range finder."""
    sequence = open_sequence(folder)
    camera = sequence.camera
    yield info(k=camera.K.ravel(), width=camera.width, height=camera.height)
    rows = [row.split(",") for row in (folder / "times.csv").read_text().splitlines()[1:]]
    for frame, (_, _, height) in zip(sequence, rows, strict=True):
        stamp = round(frame.stamp * 1e9)
        yield raw(frame.index, frame.image, stamp=stamp)
        yield message("/height", RANGE, stamp, "tof", range=float(height), min_range=-1.0, max_range=100.0)


def test_a_flight_is_the_same_from_a_bag(tmp_path, write_bag, real_data):
    folder = real_data("tello/line")
    config = load_config("tuned", settings=["mode=graph"])

    def poses(path):
        return [result.pose.mean.matrix() for result in estimate(open_sequence(path, frames="60:95"), config)]

    expected = poses(folder)
    for name in ("ros1.bag", "ros2.mcap", "sqlite.db3"):
        np.testing.assert_array_equal(poses(write_bag(tmp_path / name, tello_messages(folder))), expected)
