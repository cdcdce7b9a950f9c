"""Opening a recording: the format is found by looking at the folder, then frames, scale and ground are chosen."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.sequences import bag, euroc, folder, karlsruhe, kitti_odometry, kitti_raw, tum_rgbd, video
from fvslam_graph.sequences.ground import override_ground
from fvslam_graph.sequences.plausibility import doubts
from fvslam_graph.sequences.ros.reader import Topic


class Format(Protocol):
    """The interface of the module of a format."""

    FORMAT: str
    """Its name."""
    LAYOUT: str
    """The files that it looks for, in words."""

    def matches(self, path: Path) -> bool:
        """Whether the path looks like a recording of this format."""

    def read(self, path: Path) -> Sequence:
        """Open it; raises an FvslamError."""


# The first that matches is taken: special layouts before the plain folder.
FORMATS: tuple[Format, ...] = (kitti_odometry, kitti_raw, karlsruhe, euroc, tum_rgbd, folder, bag, video)


def open_sequence(
    path: str | Path,
    *,
    frames: str | None = None,
    stride: int = 1,
    scale: float = 1.0,
    camera_height: float | None = None,
    camera_pitch: float | None = None,
    camera_k1: float | None = None,
    format: str | None = None,
    topic: str | None = None,
) -> Sequence:
    """Open a recording of any known format, or a synthetic world by its name (`synthetic:uav?seed=3`).

    Args:
        path: Folder, video file, bag or name.
        frames: `START:STOP`, of which either may be left out.
        stride: Take every n-th frame.
        scale: Resize the images by this factor, 0 < scale <= 1.
        camera_height: Metres from the camera to the ground, where the format does not know or is wrong.
        camera_pitch: Radians by which the camera looks below the horizon; 0 is straight ahead, pi/2 straight down.
        camera_k1: Radial distortion that the calibration has left in the images, as `fvslam distortion` measures it.
        format: Name of the format, instead of finding out.
        topic: Image topic of a ROS bag, where it holds several.

    Raises:
        FvslamError: One sentence on what is missing, damaged or out of range, and where.
    """
    if not 0 < scale <= 1:
        raise SequenceError(f"the scale must be in (0, 1], not {scale:g}")
    start, stop = _slice(frames or ":")
    sequence = _synthetic(path, topic) if str(path).startswith("synthetic:") else _recorded(Path(path), format, topic)
    sequence = override_ground(sequence, camera_height, camera_pitch).select(start, stop, stride)
    if camera_k1 is not None:
        sequence = sequence.undistorted(camera_k1)
    if scale != 1:
        sequence = sequence.scaled(scale)
    source = {
        "path": str(path) if str(path).startswith("synthetic:") else str(Path(path).expanduser().absolute()),
        "frames": frames,
        "stride": stride,
        "scale": scale,
        "camera_height": camera_height,
        "camera_pitch": camera_pitch,
        "camera_k1": camera_k1,
        "format": format,
        "topic": topic,
    }
    return replace(sequence, source=source)


def topics_of(path: str | Path) -> tuple[Topic, ...]:
    """The topics of a ROS bag that have messages; none of what is no bag. Raises SequenceError where it is damaged."""
    try:
        path = Path(path).expanduser().absolute()
        return bag.topics(path) if bag.matches(path) else ()
    except (OSError, RuntimeError):  # `open_sequence` says what is wrong
        return ()


def sequence_name(path: str | Path) -> str:
    """The name that a recording has everywhere, by its path alone: that of its folder, or of its file."""
    if str(path).startswith("synthetic:"):
        return str(path)
    path = Path(path).absolute()
    if path.name == "mav0":  # of EuRoC's recordings
        return path.parent.name
    with suppress(OSError, RuntimeError):  # which opening it says better
        return path.name if path.expanduser().is_dir() else path.stem
    return path.name


def _synthetic(name: str | Path, topic: str | None) -> Sequence:
    if topic is not None:
        raise SequenceError(f"{name} is no bag, and has no topic '{topic}'")
    from fvslam_graph.simulation.synthetic import open_synthetic  # a renderer that recordings do not need

    return open_synthetic(str(name))


def _recorded(path: Path, wanted: str | None, topic: str | None) -> Sequence:
    try:
        path = path.expanduser().absolute()
        found = _find_format(path, wanted)
        if topic is None:
            sequence = found.read(path)
        elif found is bag:
            sequence = bag.read(path, topic)
        else:
            raise SequenceError(f"{path} is no bag, and has no topic '{topic}'")
    except (OSError, RuntimeError) as error:  # a folder without permission, a disk that is gone, nobody's home
        raise SequenceError(f"{path} cannot be read: {error}") from None
    left_out = sequence.ground_truth.notes if sequence.ground_truth else ()
    notes = sequence.notes + doubts(sequence.camera) + left_out
    return replace(sequence, name=sequence_name(path), notes=notes)


def _find_format(path: Path, wanted: str | None) -> Format:
    known = {module.FORMAT: module for module in FORMATS}
    if wanted is not None and wanted not in known:
        raise SequenceError(f"the format '{wanted}' is not one of {', '.join(known)}")
    if not path.exists():
        raise SequenceError(f"{path} does not exist")
    if path.is_dir() and not any(path.iterdir()):
        raise SequenceError(f"{path} is an empty folder")
    candidates = FORMATS if wanted is None else (known[wanted],)
    for module in candidates:
        if module.matches(path):
            return module
    looked_for = "; ".join(f"{module.LAYOUT} ({module.FORMAT})" for module in candidates)
    kind = "folder" if path.is_dir() else "file"
    raise SequenceError(f"the {kind} {path} is no recording of a known format; looked for {looked_for}")


def _slice(frames: str) -> tuple[int | None, int | None]:
    match = re.fullmatch(r"(-?\d+)?:(-?\d+)?", frames.strip())
    if match is None:
        raise SequenceError(f"frames are given as START:STOP, for example 100:350, not '{frames}'")
    start, stop = (int(number) if number else None for number in match.groups())
    return start, stop
