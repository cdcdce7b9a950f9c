"""Models of COLMAP, read back by pycolmap."""

import json
import shutil
from dataclasses import replace

import gtsam
import numpy as np
import pytest

import fvslam_graph
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.core.frame_result import VALUES
from fvslam_graph.runs.landmark_table import LANDMARK_COLUMNS, NEW
from fvslam_graph.runs.run_folder import LANDMARKS, read_run

BAD = ",".join(["0", "1", NEW, "0", *(len(LANDMARK_COLUMNS) - 4) * ["x"]])

pycolmap = pytest.importorskip("pycolmap")


def matrices(model):
    images = sorted(model.images.values(), key=lambda image: image.name)
    return np.array([np.vstack([image.cam_from_world().inverse().matrix(), [0, 0, 0, 1]]) for image in images])


def test_poses_and_camera(run, tmp_path):
    done = fvslam_graph.export(run, "colmap", tmp_path / "model")
    assert "there are no points" in done.notes[0]
    model = pycolmap.Reconstruction(tmp_path / "model")
    assert np.allclose(matrices(model), run.online.matrices, rtol=0, atol=1e-9)
    camera = model.cameras[1]
    assert (camera.model.name, camera.width, camera.height) == ("PINHOLE", 640, 480)
    assert camera.params.tolist() == [500, 510, 320, 240]  # the centre of the first pixel is (0.5, 0.5)
    assert {image.name for image in model.images.values()} == {f"{n:06d}.png" for n in range(8)}


def test_landmarks_come_with_the_smoothed_poses(graph_run, tmp_path):
    done = fvslam_graph.export(graph_run, "colmap", tmp_path / "model", smoothed=True)
    model = pycolmap.Reconstruction(tmp_path / "model")
    assert np.allclose(matrices(model), graph_run.smoothed.matrices, rtol=0, atol=1e-9)
    values = gtsam.Values()
    values.deserialize((graph_run.folder / VALUES).read_text())
    assert done.notes == (f"{len(model.points3D)} landmarks",) and len(model.points3D) > 10
    for number, point in model.points3D.items():
        assert np.allclose(point.xyz, values.atPoint3(gtsam.symbol("l", number - 1)), rtol=0, atol=1e-9)
        # The model projects each point by its own camera to where the image has it, as well as it says.
        errors = []
        for element in point.track.elements:
            image = model.images[element.image_id]
            seen = image.points2D[element.point2D_idx]
            assert seen.point3D_id == number
            errors.append(np.linalg.norm(image.project_point(point.xyz) - seen.xy))
        assert np.mean(errors) == pytest.approx(point.error, abs=1e-4)
    assert np.median([point.error for point in model.points3D.values()]) < 0.5  # pixels; measured 0.06


def test_landmarks_that_cannot_be_read(graph_run, tmp_path):
    header = ",".join(LANDMARK_COLUMNS) + "\n"
    for n, (name, text) in enumerate(
        [(VALUES, ""), (VALUES, "22 serialization"), (LANDMARKS, f"{header}1,2\n"), (LANDMARKS, f"{header}{BAD}\n")]
    ):
        folder = shutil.copytree(graph_run.folder, tmp_path / str(n))
        (folder / name).write_text(text)
        with pytest.raises(FvslamError, match="run it again"):
            fvslam_graph.export(folder, "colmap", tmp_path / "model", smoothed=True)


def test_the_camera_of_a_run(run, graph_run, tmp_path):
    with pytest.raises(FvslamError, match="flight does not know its camera"):
        fvslam_graph.export(replace(run, info={}), "colmap", tmp_path / "model")
    folder = shutil.copytree(graph_run.folder, tmp_path / "run")
    info = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(info | {"camera": info["camera"] | {"fx": -1}}))
    with pytest.raises(FvslamError, match="focal lengths must be positive"):
        read_run(folder)
    (folder / "run.json").write_text(json.dumps(info | {"calibration": {"focal_length": None}}))
    with pytest.raises(FvslamError, match=r"has a calibration in .* that cannot be read"):
        fvslam_graph.export(folder, "colmap", tmp_path / "model", smoothed=True)
