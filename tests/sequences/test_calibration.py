import numpy as np
import pytest

from fvslam_graph.core.camera import Camera, Distortion
from fvslam_graph.core.errors import CameraError
from fvslam_graph.sequences.calibration import read_calibration

PLAIN = """\
image_width: 64
image_height: 48
camera_matrix: [50.0, 0.0, 31.5, 0.0, 51.0, 23.5, 0.0, 0.0, 1.0]
distortion_model: radtan
distortion_coefficients: [-0.3, 0.1, 1e-3, -0.002, 0.01]
"""
OPENCV = """\
%YAML:1.0
---
calibration_time: "Mon 01 Jan 2024"
image_Width: 64
image_Height: 48
Camera_Matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.0000000000000000e+01, 0., 3.1500000000000000e+01, 0.,
       5.1000000000000000e+01, 2.3500000000000000e+01, 0., 0., 1. ]
Distortion_Coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -3.0000000000000000e-01, 1.0e-01, 1.0e-03, -2.0e-03, 1e-02 ]
"""
ROS = """\
image_width: 64
image_height: 48
camera_name: narrow
camera_matrix:
  rows: 3
  cols: 3
  data: [50.0, 0.0, 31.5, 0.0, 51.0, 23.5, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.3, 0.1, 0.001, -0.002, 0.01]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
"""
CAMERA = Camera(64, 48, 50.0, 51.0, 31.5, 23.5, Distortion.RADTAN, (-0.3, 0.1, 0.001, -0.002, 0.01))


@pytest.fixture
def camera_of(tmp_path):
    def read(text):
        path = tmp_path / "camera.yaml"
        path.write_text(text)
        return read_calibration(path).camera

    return read


@pytest.mark.parametrize("text", [PLAIN, OPENCV, ROS])
def test_the_three_forms_give_one_camera(camera_of, text):
    assert camera_of(text) == CAMERA


def test_rows_of_a_matrix(camera_of):
    text = PLAIN.replace(
        "[50.0, 0.0, 31.5, 0.0, 51.0, 23.5, 0.0, 0.0, 1.0]", "[[50, 0, 31.5], [0, 51, 23.5], [0, 0, 1]]"
    )
    assert camera_of(text) == CAMERA


def test_opencv_writes_what_is_read(tmp_path, camera_of):
    import cv2

    path = tmp_path / "written.yaml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 64)
    storage.write("image_height", 48)
    storage.write("camera_matrix", CAMERA.K)
    storage.write("distortion_coefficients", np.array(CAMERA.coefficients))
    storage.release()
    assert read_calibration(path).camera == CAMERA


def test_models(camera_of):
    four = PLAIN.replace(", 0.01]", "]")
    assert camera_of(four.replace("radtan", "equidistant")).distortion is Distortion.EQUIDISTANT
    assert camera_of(four.replace("distortion_model: radtan", "fisheye_model: 1")).distortion is Distortion.EQUIDISTANT
    assert camera_of(PLAIN.replace("distortion_model: radtan", "")).distortion is Distortion.RADTAN
    none = camera_of(ROS.replace("data: [-0.3, 0.1, 0.001, -0.002, 0.01]", "data: [0, 0, 0, 0, 0]"))
    assert none == CAMERA.undistorted()


INFO = """\
header:
  seq: 1
  stamp: {secs: 0, nsecs: 0}
  frame_id: camera
height: 48
width: 64
distortion_model: "plumb_bob"
D: [-0.3, 0.1, 0.001, -0.002, 0.01]
K: [50.0, 0.0, 31.5, 0.0, 51.0, 23.5, 0.0, 0.0, 1.0]
R: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
P: [40.0, 0.0, 31.5, 0.0, 0.0, 40.0, 23.5, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: False}
---
"""
ROS2 = INFO.replace("D:", "d:").replace("K:", "k:").replace("R:", "r:").replace("P:", "p:")
KALIBR = """\
cam0:
  T_cam_imu:
  - [0.0, -1.0, 0.0, 0.0]
  - [0.0, 0.0, -1.0, 0.0]
  - [1.0, 0.0, 0.0, 0.2]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.3, 0.1, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [50.0, 51.0, 31.5, 23.5]
  resolution: [64, 48]
  rostopic: /cam0/image_raw
cam1:
  camera_model: omni
"""
ORBSLAM = """\
%YAML:1.0
#----
Camera.type: "PinHole"
Camera.fx: 50.0
Camera.fy: 51.0
Camera.cx: 31.5
Camera.cy: 23.5
Camera.k1: -0.3
Camera.k2: 0.1
Camera.p1: 0.001
Camera.p2: -0.002
Camera.width: 64
Camera.height: 48
Camera.fps: 20.0
Camera.RGB: 1
Camera.bf: 40.0
ORBextractor.nFeatures: 1000
Viewer.KeyFrameSize: 0.05
"""
ORBSLAM3 = ORBSLAM
for _name in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"):
    ORBSLAM3 = ORBSLAM3.replace(f"Camera.{_name}:", f"Camera1.{_name}:")
ORBSLAM3 += "Camera2.fx: 1.0\nCamera2.k1: 0.5\nStereo.b: 0.1\n"
VINS = """\
%YAML:1.0
---
model_type: PINHOLE
camera_name: camera
image_width: 64
image_height: 48
distortion_parameters:
   k1: -0.3
   k2: 0.1
   p1: 0.001
   p2: -0.002
projection_parameters:
   fx: 50.0
   fy: 51.0
   cx: 31.5
   cy: 23.5
"""
FOUR = Camera(64, 48, 50.0, 51.0, 31.5, 23.5, Distortion.RADTAN, (-0.3, 0.1, 0.001, -0.002))
FISHEYE = Camera(64, 48, 50.0, 51.0, 31.5, 23.5, Distortion.EQUIDISTANT, (-0.3, 0.1, 0.001, -0.002))
KANNALA = """\
%YAML:1.0
---
model_type: KANNALA_BRANDT
image_width: 64
image_height: 48
projection_parameters: {k2: -0.3, k3: 0.1, k4: 0.001, k5: -0.002, mu: 50.0, mv: 51.0, u0: 31.5, v0: 23.5}
"""
ORB_FISHEYE = (
    ORBSLAM.replace("PinHole", "KannalaBrandt8").replace("Camera.p1", "Camera.k3").replace("Camera.p2", "Camera.k4")
)


@pytest.mark.parametrize(
    ("text", "camera"),
    [
        (INFO, CAMERA),
        (ROS2, CAMERA),
        (KALIBR, FOUR),
        (KALIBR.replace("radtan", "equidistant"), FISHEYE),
        (ORBSLAM, FOUR),
        (ORBSLAM3, FOUR),
        (ORBSLAM + "Camera.k3: 0.01\n", CAMERA),
        (ORB_FISHEYE, FISHEYE),
        ("\n".join(line for line in ORBSLAM.splitlines() if line[6:8] not in (".k", ".p")), FOUR.undistorted()),
        (VINS, FOUR),
        (KANNALA, FISHEYE),
    ],
)
def test_calibrations_of_other_tools(tmp_path, text, camera):
    (tmp_path / "camera.yaml").write_text(text)
    calibration = read_calibration(tmp_path / "camera.yaml")
    assert calibration.camera == camera and calibration.notes == ()
    assert calibration.rate == (20 if "fps" in text else None)


def test_where_the_camera_sits(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(KALIBR)
    imu_T_camera = read_calibration(path).body_T_camera
    # The camera looks along the IMU's x axis, from 0.2 m behind it.
    np.testing.assert_allclose(imu_T_camera.matrix()[:3, 2:], [[1, -0.2], [0, 0], [0, 0]], atol=1e-12)
    path.write_text(KALIBR.replace("T_cam_imu", "T_imu_cam"))
    np.testing.assert_allclose(
        read_calibration(path).body_T_camera.matrix(), imu_T_camera.inverse().matrix(), atol=1e-12
    )


RATIONAL = (2.5, 1.2, 0.0001, -0.0002, 0.05, 2.8, 1.9, 0.3)


@pytest.mark.parametrize(
    ("coefficients", "expected"),
    [
        ((*CAMERA.coefficients, 0, 0, 0), CAMERA.coefficients),
        ((*CAMERA.coefficients, *[0] * 9), CAMERA.coefficients),
        ((*CAMERA.coefficients, 0), CAMERA.coefficients),
        ((*FOUR.coefficients, 0), (*FOUR.coefficients, 0)),
        (RATIONAL, RATIONAL),
        ((*RATIONAL, 0, 0, 0, 0), RATIONAL),
        ((*RATIONAL[:7], 0), (*RATIONAL[:7], 0)),
        ([0] * 8, ()),
    ],
)
@pytest.mark.parametrize("model", ["plumb_bob", "rational_polynomial"])
def test_as_many_coefficients_as_are_not_zero(camera_of, coefficients, expected, model):
    text = PLAIN.replace("radtan", model).replace("[-0.3, 0.1, 1e-3, -0.002, 0.01]", str(list(coefficients)))
    camera = camera_of(text)
    assert camera.coefficients == expected
    kinds = {0: Distortion.NONE, 5: Distortion.RADTAN, 8: Distortion.RATIONAL}
    assert camera.distortion is kinds[len(expected)]


@pytest.mark.parametrize(
    "key", ["distortion_coeffs", "distCoeffs", "dist_coeffs", "D", "d", "Distortion-Coefficients", "distortionCoeffs"]
)
def test_spellings_of_the_coefficients(camera_of, key):
    assert camera_of(PLAIN.replace("distortion_coefficients", key)) == CAMERA


def test_what_is_not_understood_is_a_note(tmp_path):
    (tmp_path / "camera.yaml").write_text(PLAIN + "author: me\nserial: 12\n")
    assert read_calibration(tmp_path / "camera.yaml").notes == (
        "camera.yaml: not understood and left out: author, serial",
    )


@pytest.mark.parametrize("coefficients", ["-3, 0, 0, 0", "-0.3, 0.1, 0.05, 0.001, -0.002"])
def test_a_distortion_that_folds_over_or_is_in_another_order_is_a_note(tmp_path, coefficients):
    (tmp_path / "camera.yaml").write_text(PLAIN.replace("-0.3, 0.1, 1e-3, -0.002, 0.01", coefficients))
    assert "the distortion is odd for a lens" in read_calibration(tmp_path / "camera.yaml").notes[0]


def edited(text, old, new):
    assert old in text
    return text.replace(old, new)


MATRIX = "[50.0, 0.0, 31.5, 0.0, 51.0, 23.5, 0.0, 0.0, 1.0]"
COEFFICIENTS = "distortion_coefficients: [-0.3, 0.1, 1e-3, -0.002, 0.01]\n"
REFUSED = [
    (
        edited(PLAIN, MATRIX, "[50, 0, 0, 0, 51, 0, 31.5, 23.5, 1]"),
        "the rows of 'camera_matrix' should be fx 0 cx; 0 f",
    ),
    (edited(PLAIN, MATRIX, "[25, 0, 16, 0, 25, 12, 0, 0, 0.5]"), "the rows of 'camera_matrix' should be"),
    (edited(PLAIN, MATRIX, "[50, 0, 0, 0, 51, 0, 0, 0, 1]"), r"the principal point \(0, 0\) is not inside"),
    (edited(PLAIN, MATRIX, "[0.78, 0, 0.49, 0, 0.8, 0.49, 0, 0, 1]"), "a focal length of 0.78 pixels makes images 177"),
    (edited(PLAIN, MATRIX, "[0.1, 0, 31, 0, 0.1, 23, 0, 0, 1]"), "degrees wide: is it in pixels"),
    (edited(PLAIN, MATRIX, "[5000, 0, 31, 0, 5000, 23, 0, 0, 1]"), "degrees wide: is it in pixels"),
    (edited(PLAIN, MATRIX, "[50, 0, 64, 0, 51, 23.5, 0, 0, 1]"), "the principal point"),
    (edited(PLAIN, MATRIX, "[50, 0, 31.5, 0, 51, -1, 0, 0, 1]"), "the principal point"),
    (edited(PLAIN, MATRIX, "[50, 0, 31.5, 0, 5, 23.5, 0, 0, 1]"), "the focal lengths should be nearly the same"),
    (edited(PLAIN, MATRIX, "[50, 2, 31.5, 0, 51, 23.5, 0, 0, 1]"), "'camera_matrix' has a skew of 2"),
    (PLAIN + "skew: 1\n", "'skew' is not understood"),
    (PLAIN + "fisheye: true\n", "'fisheye' is not understood"),
    (PLAIN + "camera_model: omni\n", "the camera model 'omni' is not supported"),
    (edited(PLAIN, COEFFICIENTS, ""), "the distortion model 'radtan' has no coefficients"),
    (edited(PLAIN, "[-0.3, 0.1, 1e-3, -0.002, 0.01]", "[]"), "the distortion model 'radtan' has no coefficients"),
    (edited(PLAIN, "model: radtan", "model: none"), "distortion 'none' takes 0 coefficients, not 5"),
    (
        edited(PLAIN, "-0.3, 0.1, 1e-3, -0.002, 0.01", ", ".join(["0.1"] * 12)),
        "'rational' takes 8 coefficients, not 12",
    ),
    (
        edited(PLAIN, "distortion_coefficients", "distortion_coeficents"),
        "'distortion_coeficents' is not understood; the n",
    ),
    (
        edited(PLAIN, "distortion_model", "distorsion_model"),
        "'distorsion_model' is not understood; the nearest is 'dist",
    ),
    (
        edited(PLAIN, "distortion_model: radtan\ndistortion_coefficients", "RadialDistortion"),
        "'RadialDistortion' is not",
    ),
    (edited(PLAIN, COEFFICIENTS, "k1: -0.3\n").replace("radtan", "none"), "'k1' is not understood"),
    (PLAIN + "D: [0, 0, 0, 0]\n", "'distortion_coefficients' and 'D' are both given"),
    (PLAIN + "Image_Width: 65\n", "'image_width' and 'Image_Width' are the same key"),
    (edited(PLAIN, "image_width", "image_widht"), "'image_widht' is not understood; the nearest is 'image_width'"),
    (edited(PLAIN, "camera_matrix", "camera_matrx"), "none of the keys by which a calibration is known"),
    (edited(PLAIN, "64", "1e9"), "must be 16 to 10000 pixels a side, not 1000000000x48"),
    (edited(PLAIN, "64", "63.5"), "must be whole pixels, not 63.5x48"),
    (edited(PLAIN, "64", "yes"), "'image_width' should be 1 number"),
    (edited(PLAIN, "64", "9" * 400), "too large a number"),
    (edited(PLAIN, "50.0", "1e400"), "'camera_matrix' should be 9 numbers"),
    (edited(INFO, "binning_x: 0", "binning_x: 2"), "'binning' and 'roi' are not supported"),
    (edited(INFO, "x_offset: 0", "x_offset: 8"), "'binning' and 'roi' are not supported"),
    (edited(INFO, MATRIX, "[50, 0, 0, 0, 51, 0, 31.5, 23.5, 1]"), "the rows of 'K' should be"),
    (edited(KALIBR, "pinhole", "omni"), "the camera model 'omni' is not supported"),
    (edited(KALIBR, "radtan", "fov"), "the distortion model 'fov' is not one of none, radtan"),
    (edited(KALIBR, "  - [1.0, 0.0, 0.0, 0.2]", "  - [0.0, 0.0, 0.0, 0.2]"), "the rotation of 'T_cam_imu' is none"),
    (edited(KALIBR, "  - [1.0, 0.0, 0.0, 0.2]", "  - [-1.0, 0.0, 0.0, 0.2]"), "the rotation of 'T_cam_imu' is none"),
    (edited(KALIBR, "  - [0.0, 0.0, 0.0, 1.0]", "  - [0.0, 0.0, 0.2, 1.0]"), "the last row of 'T_cam_imu' should be 0"),
    ("cam0: [1]", "'cam0' should be a mapping"),
    (edited(ORBSLAM, "Camera.width: 64\n", ""), r"'Camera\.width' is missing"),
    (edited(ORBSLAM, "Camera.p2: -0.002\n", ""), r"'Camera\.p2' is missing"),
    (edited(ORBSLAM, "PinHole", "MEI"), r"'Camera\.type' should be PinHole or KannalaBrandt8, not 'MEI'"),
    (ORBSLAM + "Camera.k4: 0.1\n", r"'Camera\.k4' is not understood"),
    (edited(VINS, "PINHOLE", "MEI"), "the model_type should be PINHOLE or KANNALA_BRANDT, not 'MEI'"),
    (edited(VINS, "p2: -0.002", "p3: -0.002"), "'p2' is missing"),
]


@pytest.mark.parametrize(("text", "complaint"), REFUSED)
def test_what_cannot_be_a_calibration(camera_of, text, complaint):
    with pytest.raises(CameraError, match=rf"camera\.yaml.*{complaint}") as error:
        camera_of(text)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (PLAIN.replace("image_width: 64\n", ""), "'image_width' is missing$"),
        (PLAIN.replace("50.0, 0.0,", "50.0,"), "'camera_matrix' should be 9 numbers"),
        (PLAIN.replace("50.0, 0.0,", "50.0, .nan,"), "'camera_matrix' should be 9 numbers"),
        (PLAIN.replace("50.0", "-50.0"), "focal lengths must be positive"),
        (PLAIN.replace(", 0.01]", ", 0.01, 0.1]"), "takes 4 or 5 coefficients, not 6"),
        (PLAIN.replace("-0.3", "many"), "'distortion_coefficients' should be a list of numbers"),
        (PLAIN.replace("radtan", "omnidirectional"), "'omnidirectional' is not one of none, radtan"),
        (PLAIN.replace("[50.0", "[[50.0"), "is not valid YAML"),
        ("just words", "is not a YAML file of the form"),
        ("a: !!python/object:os.system x", "is not valid YAML"),
    ],
)
def test_bad_files_end_in_one_sentence_that_names_them(camera_of, text, complaint):
    with pytest.raises(CameraError, match=rf"camera\.yaml.*{complaint}") as error:
        camera_of(text)
    assert "\n" not in str(error.value)


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(CameraError, match=r"camera\.yaml is missing"):
        read_calibration(tmp_path / "camera.yaml")
    (tmp_path / "camera.yaml").write_bytes(b"\xff\xfe\x80")
    with pytest.raises(CameraError, match="cannot be read as text"):
        read_calibration(tmp_path / "camera.yaml")
