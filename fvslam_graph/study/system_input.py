"""A sequence as files that any program can read: numbered images, their times, the camera."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.files import write_file, writing
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.runs.ownership import FolderKind, claimed, disown


@dataclass(frozen=True)
class SystemInput:
    """What another program is given.

    Attributes:
        images: Folder of 000000.png, 000001.png, ...: rectified, grey, 8 bits; frames without an image are left out.
        times: Text file, in line i the stamp of image i in seconds.
        camera: Calibration, as the camera.yaml of a plain folder: image_width, image_height, camera_matrix, rate.
    """

    images: Path
    times: Path
    camera: Path


@contextmanager
def written_input(sequence: Sequence, folder: Path) -> Iterator[SystemInput]:
    """The files of a sequence for as long as the block lasts.

    Args:
        sequence: Its images are read once.
        folder: Created; must be empty, or left by a process that was killed here.

    Raises:
        ResultsError: It holds something else, or cannot be written.
        SequenceError: The sequence has fewer than two images.
    """
    given = SystemInput(folder / "images", folder / "times.txt", folder / "camera.yaml")
    with claimed(folder, FolderKind.IMAGES):
        try:
            with writing(folder):
                _remove(given)
                _write(sequence, given)
            yield given
        finally:
            with suppress(OSError):
                _remove(given)
                disown(folder)


def _write(sequence: Sequence, given: SystemInput) -> None:
    given.images.mkdir()
    stamps: list[float] = []
    for frame in sequence:
        if frame.image is not None:
            png = cv2.imencode(".png", frame.image)[1]
            (given.images / f"{len(stamps):06d}.png").write_bytes(png.tobytes())
            stamps.append(frame.stamp)
    if len(stamps) < 2:
        raise SequenceError(f"{sequence.name} has {len(stamps)} images that can be read; another system needs two")
    write_file(given.times, "".join(f"{stamp!r}\n" for stamp in stamps))
    write_file(given.camera, _camera_yaml(sequence.camera, float(1 / np.median(np.diff(stamps)))))


def _camera_yaml(camera: Camera, rate: float) -> str:
    content = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_matrix": camera.K.ravel().tolist(),
        "distortion_model": "none",
        "rate": rate,
    }
    return yaml.safe_dump(content, sort_keys=False)


def _remove(given: SystemInput) -> None:
    """Remove what `_write` writes; what somebody else has put there stays, and is said to be in the way."""
    for file in (*given.images.glob("[0-9]*.png"), given.times, given.camera):
        file.unlink(missing_ok=True)
    if given.images.is_dir():
        given.images.rmdir()
