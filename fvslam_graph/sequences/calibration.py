"""Cameras from calibration files: plain YAML lists, OpenCV's FileStorage, ROS's camera_info, EuRoC, KITTI."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fvslam_graph.camera import Camera, Distortion
from fvslam_graph.errors import CameraError
from fvslam_graph.sequences.tables import CalibrationText, read_text

_MODELS = {
    "none": Distortion.NONE,
    "radtan": Distortion.RADTAN,
    "radial-tangential": Distortion.RADTAN,  # EuRoC
    "plumb_bob": Distortion.RADTAN,  # ROS
    "equidistant": Distortion.EQUIDISTANT,
    "fisheye": Distortion.EQUIDISTANT,
}


class _Loader(yaml.SafeLoader):
    """YAML with OpenCV's matrices, which become mappings with a key `data`."""


def _matrix(loader: _Loader, _kind: str, node: yaml.MappingNode) -> dict[Hashable, Any]:
    return loader.construct_mapping(node, deep=True)


_Loader.add_multi_constructor("tag:yaml.org,2002:opencv-", _matrix)  # -matrix, and -nd-matrix since OpenCV 5


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML mapping, its keys in lower case (OpenCV's samples vary); raises CameraError or SequenceError."""
    # OpenCV writes '%YAML:1.0', which is not the directive that the standard asks for.
    text = "\n".join(line for line in read_text(path).splitlines() if not line.startswith("%"))
    try:
        content = yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        raise CameraError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, dict):
        raise CameraError(f"{path} is not a YAML file of the form 'key: value'")
    return {str(key).lower(): value for key, value in content.items()}


def read_camera(path: Path) -> Camera:
    """A camera from a `camera.yaml`.

    Read are `image_width`, `image_height`, `camera_matrix` (9 numbers, row by row, or a mapping with `data`),
    `distortion_coefficients` (the same; optional) and `distortion_model`. Without a model, coefficients are taken as
    radial-tangential, or as equidistant where OpenCV's `fisheye_model` is set.

    Raises:
        CameraError: The file is not of this form or describes no camera.
    """
    content = read_yaml(path)
    size = numbers(path, content, "image_width", 1) + numbers(path, content, "image_height", 1)
    fx, _, cx, _, fy, cy, *_ = numbers(path, content, "camera_matrix", 9)
    coefficients = numbers(path, content, "distortion_coefficients") if "distortion_coefficients" in content else []
    default = "fisheye" if content.get("fisheye_model") else "radtan" if coefficients else "none"
    model = content.get("distortion_model") or default
    return make_camera(path, size, (fx, fy, cx, cy), str(model), coefficients)


def make_camera(
    path: Path, size: Sequence[float], intrinsics: Sequence[float], model: str, coefficients: Sequence[float]
) -> Camera:
    """A camera whose errors name the file it comes from.

    Args:
        path: That file.
        size: Width, height, pixels.
        intrinsics: fx, fy, cx, cy, pixels.
        model: Name of the distortion model, as this package, EuRoC, ROS or OpenCV spell it.
        coefficients: Its coefficients.

    Raises:
        CameraError: An unknown model, or numbers that make no camera.
    """
    if model.lower() not in _MODELS:
        raise CameraError(f"{path}: the distortion model '{model}' is not one of {', '.join(_MODELS)}")
    distortion = _MODELS[model.lower()]
    if distortion is not Distortion.EQUIDISTANT and not np.any(np.asarray(coefficients, float)):
        distortion, coefficients = Distortion.NONE, ()
    fx, fy, cx, cy = map(float, intrinsics)
    try:
        return Camera(int(size[0]), int(size[1]), fx, fy, cx, cy, distortion, tuple(map(float, coefficients)))
    except CameraError as error:
        raise CameraError(f"{path}: {error}") from None


def projection_camera(calibration: CalibrationText, key: str, size: Sequence[float]) -> Camera:
    """The camera of rectified images of `size` (width, height), from a 3x4 projection matrix; raises CameraError."""
    P = calibration.numbers(key, 3, 4)
    return make_camera(calibration.path, size, (P[0, 0], P[1, 1], P[0, 2], P[1, 2]), "none", ())


def numbers(path: Path, content: dict[str, Any], key: str, count: int | None = None) -> list[float]:
    """The numbers of one key: a number, a list, a list of rows, or a matrix mapping; raises CameraError."""
    value = content.get(key.lower())
    if isinstance(value, dict):
        value = value.get("data")
    try:
        values = np.array(value, float).ravel()
    except (TypeError, ValueError):
        values = np.array([np.nan])
    if value is None or not np.all(np.isfinite(values)) or count not in (None, len(values)):
        raise CameraError(f"{path}: '{key}' should be {count or 'a list of'} number{'s' * (count != 1)}")
    return [float(number) for number in values]
