"""The calibration of an image topic: its camera_info, or a file beside the bag."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from fvslam_graph.core.errors import CameraError
from fvslam_graph.sequences.calibration import Calibration, calibration_of, read_calibration
from fvslam_graph.sequences.entries import Entries
from fvslam_graph.sequences.ros.reader import Bag

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"


def bag_calibration(bag: Bag, topic: str) -> tuple[Calibration, Path, tuple[str, ...]]:
    """The calibration of an image topic, where it comes from, and notes; by camera_info, else by a file beside the bag.

    Raises:
        CameraError: There is none, or none that makes a camera.
    """
    path = bag.path
    beside = [path / "camera.yaml"] if path.is_dir() else [path.with_suffix(".yaml")]
    beside.append(path.parent / "camera.yaml")
    file = next((file for file in beside if file.is_file()), None)
    info = _camera_info(bag, topic)
    source = None if info is None else path / info.lstrip("/")
    message = None if info is None else bag.first(info)
    matrix = None if message is None else np.ravel(getattr(message, "k", getattr(message, "K", ())))
    if source is not None and message is not None and np.any(matrix):
        notes = (f"{file.name} is left out, as {info} has the calibration",) if file else ()
        return calibration_of(_entries(source, message)), source, notes
    if file is not None:
        notes = (f"{info} is not calibrated, {file.name} is taken",) if info else ()
        return read_calibration(file), file, notes
    problem = (
        f"{source} is of a camera that is not calibrated, K is zero"
        if info
        else f"{path} has no camera_info of {topic}"
    )
    raise CameraError(f"{problem}: write {beside[0].name} or {beside[-1].name} beside the bag")


def _camera_info(bag: Bag, topic: str) -> str | None:
    """The camera_info in the nearest namespace of an image topic, else the only one."""
    infos = [info.name for info in bag.of_type(CAMERA_INFO)]
    while topic:
        topic = topic.rpartition("/")[0]
        if f"{topic}/camera_info" in infos:
            return f"{topic}/camera_info"
    return infos[0] if len(infos) == 1 else None


def _entries(source: Path, message: Any) -> Entries:
    """A CameraInfo message as a calibration file; without coefficients it has no distortion, whatever the model."""
    content = {name: value for name, value in dataclasses.asdict(message).items() if name != "__msgtype__"}
    if not len(content.get("d", content.get("D", ()))):
        content["distortion_model"] = "none"
    return Entries(source, content)
