"""Tiny recordings for the readers' tests."""

from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest

CAMERA_YAML = """\
image_width: 64
image_height: 48
camera_matrix: [50.0, 0.0, 31.5, 0.0, 51.0, 23.5, 0.0, 0.0, 1.0]
distortion_model: none
distortion_coefficients: []
"""


@pytest.fixture
def write_images() -> Callable[..., list[Path]]:
    """Writes random 64x48 images; the brightness of pixel (0, 0) is 10 times the image's position."""

    def write(folder: Path, names: Iterable[str], size: tuple[int, int] = (64, 48)) -> list[Path]:
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / name for name in names]
        for position, path in enumerate(paths):
            image = np.random.default_rng(position).integers(0, 256, size[::-1], np.uint8)
            image[0, 0] = 10 * position
            assert cv2.imwrite(str(path), image)
        return paths

    return write


@pytest.fixture
def plain_folder(tmp_path: Path, write_images: Callable[..., list[Path]]) -> Path:
    """A plain folder of ten images at 10 Hz, with heights."""
    folder = tmp_path / "flight"
    paths = write_images(folder / "images", [f"{number}.png" for number in range(10)])
    (folder / "camera.yaml").write_text(CAMERA_YAML)
    rows = [f"{path.name},{0.1 * number:.3f},{0.5 * number:.2f}\n" for number, path in enumerate(paths)]
    (folder / "times.csv").write_text("filename,timestamp_s,height_m\n" + "".join(rows))
    return folder
