"""Opening a recording: the format is found by looking at the folder, then frames, scale and ground are chosen."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Protocol, TypedDict, Unpack

import numpy as np

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.plugins import Kind, find, names
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.sequences import bag, euroc, folder, karlsruhe, kitti_odometry, kitti_raw, tum_rgbd, video
from fvslam_graph.sequences.calibration import read_calibration
from fvslam_graph.sequences.ground import override_ground
from fvslam_graph.sequences.plausibility import doubts
from fvslam_graph.sequences.ros.reader import Topic
from fvslam_graph.sequences.telemetry import add_telemetry, add_telemetry_beside


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


# The first that matches is taken: special layouts before the plain folder. Those of other packages come before all.
FORMATS: tuple[Format, ...] = (kitti_odometry, kitti_raw, karlsruhe, euroc, tum_rgbd, folder, bag, video)


class SequenceOptions(TypedDict, total=False):
    """What of a recording to open, and what is known of it beside its files.

    Attributes:
        frames: `START:STOP`, of which either may be left out.
        stride: Take every n-th frame.
        scale: Resize the images by this factor, 0 < scale <= 1.
        camera_height: Metres from the camera to the ground, where the format does not know or is wrong.
        camera_pitch: Radians by which the camera looks below the horizon; 0 is straight ahead, pi/2 straight down.
        recalibration: Calibration file of the images as they are once undistorted, as `fvslam calibrate` writes it.
        fov: Degrees that the images of a video are wide, where it has no calibration, or instead of it.
        telemetry: What a drone recorded, `.srt` or `.csv`; beside a video, a file of the same name is found.
        telemetry_offset: Seconds to add to its times to have those since the first frame; estimated if not given.
        format: Name of the format, or the path of one such as "mypkg:MyFormat", instead of finding out.
        topic: Image topic of a ROS bag, where it holds several.
    """

    frames: str | None
    stride: int
    scale: float
    camera_height: float | None
    camera_pitch: float | None
    recalibration: str | Path | None
    fov: float | None
    telemetry: str | Path | None
    telemetry_offset: float | None
    format: str | None
    topic: str | None


def open_sequence(path: str | Path, **options: Unpack[SequenceOptions]) -> Sequence:
    """Open a recording of any known format, or a synthetic world by its name (`synthetic:uav?seed=3`).

    Args:
        path: Folder, video file, bag or name.
        options: See `SequenceOptions`.

    Raises:
        FvslamError: One sentence on what is missing, damaged or out of range, and where.
    """
    if unknown := set(options) - set(SequenceOptions.__annotations__):
        raise TypeError(f"a sequence is opened without {', '.join(sorted(unknown))}")
    scale, fov, recalibration = options.get("scale", 1.0), options.get("fov"), options.get("recalibration")
    if not 0 < scale <= 1:
        raise SequenceError(f"the scale must be in (0, 1], not {scale:g}")
    start, stop = _slice(options.get("frames") or ":")
    if str(path).startswith("synthetic:"):
        sequence = _synthetic(path, options.get("topic"))
    else:
        sequence = _recorded(Path(path), options.get("format"), options.get("topic"), fov)
    if fov is not None and sequence.format != video.FORMAT:
        raise SequenceError(f"a field of view is for videos; {path} has a calibration")
    sequence = _with_telemetry(sequence, path, options.get("telemetry"), options.get("telemetry_offset"))
    sequence = override_ground(sequence, options.get("camera_height"), options.get("camera_pitch"))
    sequence = sequence.select(start, stop, options.get("stride", 1))
    if recalibration is not None:
        sequence = sequence.recalibrated(read_calibration(Path(recalibration).expanduser()).camera)
    if scale != 1:
        sequence = sequence.scaled(scale)
    places = {"path": path, "telemetry": options.get("telemetry"), "recalibration": recalibration}
    source = {**options, **{name: _absolute(place) for name, place in places.items() if place is not None}}
    return replace(sequence, source=source)


def _absolute(place: str | Path) -> str:
    """A path that means the same in any folder; the name of a synthetic world as it is."""
    return str(place) if str(place).startswith("synthetic:") else str(Path(place).expanduser().absolute())


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


def _with_telemetry(sequence: Sequence, path: str | Path, given: str | Path | None, offset: float | None) -> Sequence:
    if offset is not None and not np.isfinite(offset):
        raise SequenceError(f"the offset of the telemetry must be a number of seconds, not {offset:g}")
    if given is not None:
        return add_telemetry(sequence, Path(given).expanduser(), offset)
    if sequence.format == video.FORMAT:
        return add_telemetry_beside(sequence, Path(path).expanduser().absolute(), offset)
    if offset is not None:
        raise SequenceError(f"no telemetry of {sequence.name} is given, whose clock could be off")
    return sequence


def _recorded(path: Path, wanted: str | None, topic: str | None, fov: float | None) -> Sequence:
    formats = _formats() if wanted is None else _named(wanted)
    try:
        path = path.expanduser().absolute()
        name, format = _find_format(path, formats)
        if topic is not None and format is not bag:
            raise SequenceError(f"{path} is no bag, and has no topic '{topic}'")
        sequence: object
        if format is bag:
            sequence = bag.read(path, topic)
        elif format is video:
            sequence = video.read(path, fov)
        else:
            sequence = format.read(path)
    except (OSError, RuntimeError) as error:  # a folder without permission, a disk that is gone, nobody's home
        raise SequenceError(f"{path} cannot be read: {error}") from None
    if not isinstance(sequence, Sequence):
        raise SequenceError(f"the format '{name}' makes an object of {type(sequence).__name__} of {path}, no Sequence")
    left_out = sequence.ground_truth.notes if sequence.ground_truth else ()
    notes = sequence.notes + doubts(sequence.camera) + left_out
    return replace(sequence, name=sequence_name(path), format=name, notes=notes)


def _formats() -> dict[str, Format]:
    """All formats by their names."""
    ours = {format.FORMAT: format for format in FORMATS}
    added = {name: _added(name) for name in names(Kind.FORMAT)}
    return {name: format for name, format in added.items() if format is not None} | ours


def _named(name: str) -> dict[str, Format]:
    """The one format of a name."""
    added = _added(name)
    known = _formats() if added is None else {name: added}
    if name not in known:
        raise SequenceError(f"the format '{name}' is not one of {', '.join(known)}")
    return {name: known[name]}


def _added(name: str) -> Format | None:
    """The format of another package that is called so."""
    plugin = find(name, (Kind.FORMAT,), [format.FORMAT for format in FORMATS])
    if plugin is None:
        return None
    made: Format = plugin.make()
    return made


def _find_format(path: Path, formats: Mapping[str, Format]) -> tuple[str, Format]:
    """The first format that matches, and its name."""
    if not path.exists():
        raise SequenceError(f"{path} does not exist")
    if path.is_dir() and not any(path.iterdir()):
        raise SequenceError(f"{path} is an empty folder")
    for name, format in formats.items():
        if format.matches(path):
            return name, format
    looked_for = "; ".join(f"{format.LAYOUT} ({name})" for name, format in formats.items())
    kind = "folder" if path.is_dir() else "file"
    raise SequenceError(f"the {kind} {path} is no recording of a known format; looked for {looked_for}")


def _slice(frames: str) -> tuple[int | None, int | None]:
    match = re.fullmatch(r"(-?\d+)?:(-?\d+)?", frames.strip())
    if match is None:
        raise SequenceError(f"frames are given as START:STOP, for example 100:350, not '{frames}'")
    start, stop = (int(number) if number else None for number in match.groups())
    return start, stop
