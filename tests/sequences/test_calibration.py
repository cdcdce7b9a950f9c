import numpy as np
import pytest

from fvslam_graph.camera import Camera, Distortion
from fvslam_graph.errors import CameraError
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
