"""Cameras from calibration files, each tool's layout told by a key that only it has."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.errors import CameraError
from fvslam_graph.sequences.entries import Entries
from fvslam_graph.sequences.plausibility import distorts_oddly, make_camera, pinhole, rigid_pose
from fvslam_graph.sequences.tables import CalibrationText

_MODEL = ("distortion_model",)
_COEFFICIENT_KEYS = ("distortion_coefficients", "distortion_coeffs", "dist_coeffs", "D")
_MATRIX = ("camera_matrix", "K")
_RATE_KEYS = ("rate", "rate_hz", "fps", "Camera.fps")


@dataclass(frozen=True)
class Calibration:
    """The content of a calibration file.

    Attributes:
        camera: The camera as built.
        body_T_camera: Where it sits on the vehicle, or on the IMU; None where the file does not say.
        rate: Images a second; None where the file does not say.
        notes: Oddities, one sentence each.
    """

    camera: Camera
    body_T_camera: gtsam.Pose3 | None = None
    rate: float | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class CalibrationLayout:
    """How a tool writes calibrations.

    Attributes:
        tool: Whose layout it is.
        key: The key that tells it.
        camera: Reads the camera.
        others: The keys besides that the tool writes and that do not matter here, as a regular expression over lower
            case without underscores.
    """

    tool: str
    key: str
    camera: Callable[[Entries], Camera]
    others: str


def read_calibration(path: Path) -> Calibration:
    """A calibration in any of the layouts that `LAYOUTS` lists.

    Raises:
        CameraError: The file is of none of them, lacks something, has a key that is nearly right or describes no
            camera.
    """
    return calibration_of(Entries.read(path))


def calibration_of(entries: Entries) -> Calibration:
    """The calibration that these entries are; see `read_calibration`."""
    path = entries.path
    layout = next((layout for layout in LAYOUTS if entries.has(layout.key)), None)
    if layout is None:
        known = ", ".join(f"'{layout.key}' ({layout.tool})" for layout in LAYOUTS)
        raise CameraError(f"{path} has none of the keys by which a calibration is known: {known}")
    if layout.key == "cam0":
        entries = entries.section("cam0")
    camera = layout.camera(entries)
    rate = entries.number(*_RATE_KEYS) if entries.has(*_RATE_KEYS) else entries.get(*_RATE_KEYS)
    body_T_camera = _body_T_camera(entries)
    notes: tuple[str, ...] = ()
    if left := entries.left(layout.others):
        more = f" and {len(left) - 5} more" if len(left) > 5 else ""
        notes += (f"{path.name}: not understood and left out: {', '.join(left[:5])}{more}",)
    if distorts_oddly(camera):
        notes += (f"{path.name}: the distortion is odd for a lens; is the order of its coefficients k1 k2 p1 p2 k3?",)
    return Calibration(camera, body_T_camera, rate, notes)


def projection_camera(calibration: CalibrationText, key: str, size: Sequence[float]) -> Camera:
    """The camera of rectified images of `size` (width, height), from a 3x4 projection matrix; raises CameraError."""
    intrinsics = pinhole(calibration.path, key, calibration.numbers(key, 3, 4))
    return make_camera(calibration.path, size, intrinsics, "none", None)


def _matrix(entries: Entries) -> Camera:
    """OpenCV, both forms of ROS, this package: a 3x3 matrix."""
    size = _size(entries)
    key = next(name for name in _MATRIX if entries.has(name))
    intrinsics = pinhole(entries.path, key, np.reshape(entries.numbers(*_MATRIX, count=9), (3, 3)))
    binning = [entries.number(name) for name in ("binning_x", "binning_y") if entries.has(name)]
    region = entries.section("roi") if entries.has("roi") else entries
    offsets = [region.number(name) for name in ("x_offset", "y_offset") if region.has(name)]
    if max(binning, default=0) > 1 or any(offsets):
        raise CameraError(f"{entries.path}: 'binning' and 'roi' are not supported: give the matrix of these images")
    _require_pinhole(entries)
    default = "fisheye" if entries.get("fisheye_model") else ""
    model = str(entries.get(*_MODEL) or default)
    return make_camera(entries.path, size, intrinsics, model, _coefficients(entries))


def _list(entries: Entries) -> Camera:
    """EuRoC and Kalibr: fx, fy, cx, cy in a list."""
    _require_pinhole(entries)
    intrinsics = entries.numbers("intrinsics", count=4)
    model = str(entries.get(*_MODEL) or "")
    return make_camera(entries.path, _size(entries), intrinsics, model, _coefficients(entries))


def _vins(entries: Entries) -> Camera:
    """VINS-Fusion's camera files, which are camodocal's."""
    kind = str(entries.get("model_type")).upper()
    inner = entries.section("projection_parameters")
    if kind == "PINHOLE":
        lens = entries.section("distortion_parameters")
        intrinsics = [inner.number(name) for name in ("fx", "fy", "cx", "cy")]
        coefficients = [lens.number(name) for name in ("k1", "k2", "p1", "p2")]
        return make_camera(entries.path, _size(entries), intrinsics, "radtan", coefficients)
    if kind == "KANNALA_BRANDT":
        intrinsics = [inner.number(name) for name in ("mu", "mv", "u0", "v0")]
        coefficients = [inner.number(name) for name in ("k2", "k3", "k4", "k5")]
        return make_camera(entries.path, _size(entries), intrinsics, "equidistant", coefficients)
    raise CameraError(f"{entries.path}: the model_type should be PINHOLE or KANNALA_BRANDT, not '{kind}'")


def _orbslam(entries: Entries) -> Camera:
    """ORB-SLAM2 (Camera.fx) and ORB-SLAM3 (Camera1.fx)."""

    def names(name: str) -> tuple[str, str]:
        return f"Camera.{name}", f"Camera1.{name}"

    size = [entries.number(*names(name)) for name in ("width", "height")]
    intrinsics = [entries.number(*names(name)) for name in ("fx", "fy", "cx", "cy")]
    kind = str(entries.get("Camera.type", default="PinHole"))
    if kind.lower() == "kannalabrandt8":
        model, lens = "equidistant", ["k1", "k2", "k3", "k4"]
    elif kind.lower() in ("pinhole", "rectified"):
        given = [name for name in ("k1", "k2", "p1", "p2", "k3") if entries.has(*names(name))]
        model, lens = ("radtan", ["k1", "k2", "p1", "p2", *given[4:]]) if given else ("none", [])
    else:
        raise CameraError(f"{entries.path}: 'Camera.type' should be PinHole or KannalaBrandt8, not '{kind}'")
    return make_camera(entries.path, size, intrinsics, model, [entries.number(*names(name)) for name in lens])


_KALIBR = "camoverlaps|rostopic|tcncnm1|timeshiftcamimu|linedelay"
_ORBSLAM = r"(?!camera1?\.).*|camera\.(bf|rgb|newwidth|newheight)"
LAYOUTS = (
    CalibrationLayout("Kalibr", "cam0", _list, _KALIBR),
    CalibrationLayout("EuRoC", "intrinsics", _list, f"sensortype|comment|{_KALIBR}"),
    CalibrationLayout("VINS-Fusion", "projection_parameters", _vins, ".*"),
    CalibrationLayout("ORB-SLAM", "Camera.fx", _orbslam, _ORBSLAM),
    CalibrationLayout("ORB-SLAM3", "Camera1.fx", _orbslam, _ORBSLAM),
    CalibrationLayout(
        "OpenCV, ROS, this package",
        "camera_matrix",
        _matrix,
        "calibrationtime|nframes|nrofframes|board(width|height)|squaresize|markersize|(fix)?aspectratio|flags"
        "|avgreprojectionerror|perviewreprojectionerrors|imagepoints|gridpoints|extrinsicparameters"
        "|standarddeviations|cameraname|(rectification|projection)matrix|tbs|comment",
    ),
    CalibrationLayout("ROS's camera_info", "K", _matrix, "header|r|p"),
)


def _require_pinhole(entries: Entries) -> None:
    kind = str(entries.get("camera_model", default="pinhole"))
    if kind.lower() != "pinhole":
        raise CameraError(f"{entries.path}: the camera model '{kind}' is not supported, only 'pinhole' is")


def _size(entries: Entries) -> list[float]:
    if entries.has("resolution", "image_size"):
        return entries.numbers("resolution", "image_size", count=2)
    return [entries.number("image_width", "width"), entries.number("image_height", "height")]


def _coefficients(entries: Entries) -> list[float] | None:
    return entries.numbers(*_COEFFICIENT_KEYS) if entries.has(*_COEFFICIENT_KEYS) else entries.get(*_COEFFICIENT_KEYS)


def _body_T_camera(entries: Entries) -> gtsam.Pose3 | None:
    for key in ("T_BS", "T_imu_cam", "T_cam_imu"):
        if entries.has(key):
            pose = rigid_pose(entries.path, key, np.reshape(entries.numbers(key, count=16), (4, 4)))
            return pose.inverse() if key == "T_cam_imu" else pose
    return None
