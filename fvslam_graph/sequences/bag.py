"""ROS bags: images with camera_info, ground truth from TF, odometry or pose topics, and other sensors; without ROS."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sensors import SensorSeries
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.sequences.files import count_of, only_one
from fvslam_graph.sequences.images import Images
from fvslam_graph.sequences.ros import frames, images, poses, sensors
from fvslam_graph.sequences.ros.camera import bag_calibration
from fvslam_graph.sequences.ros.reader import Bag, Rows, Topic, stamp_of
from fvslam_graph.sequences.tables import MIN_STEP, require_increasing

FORMAT = "rosbag"
LAYOUT = "a ROS bag: a .bag, .mcap or .db3 file, or a folder with metadata.yaml"

BAG_SUFFIXES = {".bag", ".mcap", ".db3"}


def matches(path: Path) -> bool:
    """Whether this is a file of a bag by its suffix, or a folder of ROS 2."""
    return (
        path.suffix in BAG_SUFFIXES if path.is_file() else (path / "metadata.yaml").is_file() or bool(_storages(path))
    )


def topics(path: Path) -> tuple[Topic, ...]:
    """The topics of a bag that have messages; raises SequenceError where it cannot be read."""
    return tuple(_open(path).topics.values())


def read(path: Path, topic: str | None = None) -> Sequence:
    """Open a bag; `topic` chooses among several image topics.

    Stamps are those of the message headers. One pass reads them, poses and sensors; images are decoded on demand.
    """
    bag = _open(path)
    chosen = _image_topic(bag, topic)
    first = bag.first(chosen.name)
    if chosen.type == images.RAW_IMAGE and first.encoding.lower() not in images.ENCODINGS:
        known = ", ".join(images.ENCODINGS)
        raise SequenceError(f"{path}: {chosen.name} has the encoding '{first.encoding}'; read are {known}")
    camera_frame = frames.frame_name(first.header.frame_id)
    calibration, source, notes = bag_calibration(bag, chosen.name)

    candidates = poses.by_preference(bag.of_type(*poses.POSE_TYPES))
    takes: dict[str, Callable[[Any], Any]] = {chosen.name: stamp_of}
    takes |= {candidate.name: poses.pose_of for candidate in candidates[:1]}
    takes |= {known.name: frames.transforms_of for known in bag.of_type(*frames.TF_TYPES)}
    takes |= {known.name: sensors.SENSOR_READERS[known.type][1] for known in bag.of_type(*sensors.SENSOR_READERS)}
    rows, damage = bag.collect(takes)

    messages, stamps, order = _in_order(bag, chosen.name, rows)
    pictures = Images(messages, lambda message: message.decode(bag))
    tree = _frame_tree(bag, rows)
    truth, about_truth = _ground_truth(bag, candidates, rows, tree, camera_frame)
    series = _sensors(bag, rows)
    ground, about_ground = sensors.ground_below(_range_finders(bag, series), tree, camera_frame, stamps)
    camera = calibration.camera
    return Sequence(
        name=path.name if path.is_dir() else path.stem,
        format=FORMAT,
        camera=camera.undistorted(),
        stamps=stamps,
        load=pictures.loader(camera, source),
        ground_truth=truth,
        ground=ground,
        sensors=series,
        notes=notes + calibration.notes + damage + order + pictures.notes(camera) + about_truth + about_ground,
    )


def _storages(path: Path) -> list[Path]:
    return sorted(file for suffix in (".mcap", ".db3") for file in path.glob(f"*{suffix}"))


def _open(path: Path) -> Bag:
    """The bag; of a folder whose metadata.yaml was never written, its only file."""
    for file in _storages(path):
        if not file.is_file():  # a pipe would wait for ever
            raise SequenceError(f"{file} is no regular file")
    whole = path.is_file() or (path / "metadata.yaml").is_file()
    bag = Bag(path if whole else only_one(path, _storages(path), "bag file"))
    if not bag.topics:
        raise SequenceError(f"{path} holds no messages")
    return bag


def _image_topic(bag: Bag, name: str | None) -> Topic:
    found = bag.of_type(images.RAW_IMAGE, images.COMPRESSED_IMAGE)
    listed = ", ".join(topic.name for topic in found)
    if not found:
        raise SequenceError(f"{bag.path} holds no images; its topics are {', '.join(bag.topics)}")
    if name is not None:
        chosen = [topic for topic in found if topic.name.strip("/") == name.strip("/")]
        if not chosen:
            raise SequenceError(f"{bag.path} has no image topic '{name}'; there are {listed}")
        return chosen[0]
    if len(found) > 1:
        raise SequenceError(f"{bag.path} holds {len(found)} image topics, choose one by --topic: {listed}")
    return found[0]


def _in_order(
    bag: Bag, topic: str, rows: Rows
) -> tuple[list[images.ImageMessage], NDArray[np.float64], tuple[str, ...]]:
    """The images in the order of their stamps, these stamps (N,) in seconds, and notes.

    Raises:
        SequenceError: There are none, or they make no possible frame rate.
    """
    received, stamps = np.array(rows[topic], np.int64).reshape(-1, 2).T
    notes = []
    if not np.any(stamps):
        times = received
        if len(times):
            notes.append(f"{topic} has no stamps: the times of receipt are taken")
    else:
        received, stamps = received[stamps != 0], stamps[stamps != 0]
        if unset := len(rows[topic]) - len(stamps):
            notes.append(f"{count_of(unset, 'image')} without a stamp and left out")
        times = stamps
    if backwards := int(np.sum(np.diff(times) < 0)):
        notes.append(f"{count_of(backwards, 'image')} older than the one before: they are sorted by their stamps")
    order = np.argsort(times, kind="stable")
    order = order[np.diff(times[order], prepend=-(10**9)) > MIN_STEP * 1e9]
    if repeated := len(times) - len(order):
        notes.append(f"{count_of(repeated, 'image')} of the same stamp as another and left out")
    if not len(order):
        raise SequenceError(f"{bag.path}: {topic} holds no images that can be read")
    seconds = times[order] / 1e9
    require_increasing(bag.path, seconds)
    messages = [images.ImageMessage(topic, int(received[i]), int(stamps[i])) for i in order]
    return messages, seconds, tuple(notes)


def _ground_truth(
    bag: Bag, candidates: list[Topic], rows: Rows, tree: frames.FrameTree, camera: str
) -> tuple[Trajectory | None, tuple[str, ...]]:
    """world_T_camera, and notes that say where it comes from."""
    if candidates and (measured := [row for _, row in rows[candidates[0].name]]):
        truth, notes = poses.camera_poses(bag.path, measured, tree, camera)
        others = ", ".join(candidate.name for candidate in candidates[1:])
        instead = f"; there are also {others}" if others else ""
        return truth, (f"the ground truth is {candidates[0].name}, {candidates[0].type}{instead}", *notes)
    if found := tree.moving(camera):
        return found[1], (f"the ground truth is TF, from '{found[0]}' to '{camera}'",)
    return None, ()


def _frame_tree(bag: Bag, rows: Rows) -> frames.FrameTree:
    messages = [transforms for known in bag.of_type(*frames.TF_TYPES) for _, transforms in rows[known.name]]
    return frames.FrameTree(bag.path, itertools.chain.from_iterable(messages))


def _range_finders(bag: Bag, series: tuple[SensorSeries, ...]) -> list[sensors.RangeFinder]:
    return [
        sensors.RangeFinder(known, frames.frame_name(bag.first(known.source).header.frame_id))
        for known in series
        if bag.topics[known.source].type == sensors.RANGE_TYPE
    ]


def _sensors(bag: Bag, rows: Rows) -> tuple[SensorSeries, ...]:
    made = [
        sensors.series_of(
            sensors.SENSOR_READERS[known.type][0], known.name, [reading for _, reading in rows[known.name]]
        )
        for known in bag.of_type(*sensors.SENSOR_READERS)
    ]
    return tuple(series for series in made if series is not None)
