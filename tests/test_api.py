"""The package from Python."""

import re
from dataclasses import replace

import cv2
import gtsam
import numpy as np
import pytest

import fvslam_graph
from fvslam_graph.core.camera import Distortion
from fvslam_graph.core.choices import Mode
from fvslam_graph.core.errors import ConfigError, EstimationError, FvslamError
from fvslam_graph.core.geodesy import LocalFrame
from fvslam_graph.core.sequence import Ground
from fvslam_graph.core.trajectory import Status, Trajectory
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.plots.landmarks import plot_landmarks
from fvslam_graph.evaluation.plots.runs import FIGURES, plot_runs
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.simulation.gnss import PLACE, true_enu
from fvslam_graph.study.results import StudyResults
from fvslam_graph.testing import rendered

SHORT = "synthetic:uav?frames=12&size=320x240"


def test_a_run_in_memory_is_the_run_in_a_folder(tmp_path, undrawn):
    options = {"mode": "graph", "settings": {"slam.min_landmarks": 30, "scale.source": "oracle"}, "seed": 2}
    memory = fvslam_graph.run(SHORT, **options)
    folder = fvslam_graph.run(open_sequence(SHORT), **options, out=tmp_path / "run")
    assert (memory.folder, folder.folder) == (None, tmp_path / "run")
    assert np.array_equal(memory.smoothed.stamps, folder.smoothed.stamps)
    for a, b in ((memory.online, folder.online), (memory.smoothed, folder.smoothed)):
        assert np.allclose(a.matrices, b.matrices, atol=1e-12)
    assert np.array_equal(memory.relatives.covariances, folder.relatives.covariances, equal_nan=True)
    assert list(memory.frames) == list(folder.frames)
    assert memory.frames["status"].tolist() == folder.frames["status"].tolist()
    assert np.allclose(memory.frames["scale"], folder.frames["scale"], equal_nan=True)
    assert memory.config == folder.config
    assert all(folder.info[key] == value for key, value in memory.info.items() if key != "down")
    assert len(plot_runs([memory], tmp_path / "plots")) == 2 * len(FIGURES)
    at = int(np.flatnonzero(folder.frames["landmarks"] > 0)[-1])
    assert len(plot_landmarks(tmp_path / "run", [at], tmp_path / "plots")) == 1


def test_landmarks_of_a_recording_that_cannot_be_opened_again(tmp_path):
    fvslam_graph.run(open_sequence(SHORT).select(2), mode="vslam", out=tmp_path / "run")
    with pytest.raises(FvslamError, match="does not know the recording"):
        plot_landmarks(tmp_path / "run", [5], tmp_path / "plots")


def test_everything_that_can_be_evaluated(tmp_path):
    run = fvslam_graph.run(SHORT, out=tmp_path / "run")
    run.ground_truth.write_tum(tmp_path / "truth.tum")
    first = fvslam_graph.evaluate(run, align="sim3")
    error = first.errors["ape_trans"].stats["rmse"]
    assert 0 < error < 0.5 and first.consistency is not None
    for estimated in (run, run.online, tmp_path / "run", str(tmp_path / "run" / "trajectory_online.tum")):
        for reference in (run.ground_truth, tmp_path / "truth.tum"):
            again = fvslam_graph.evaluate(estimated, reference, "sim3")
            assert again.errors["ape_trans"].stats["rmse"] == pytest.approx(error, rel=1e-9)


def test_what_cannot_be_run_or_evaluated():
    with pytest.raises(ConfigError, match="'mode' cannot be 'slam'"):
        fvslam_graph.run(SHORT, mode="slam")
    run = fvslam_graph.run(SHORT)
    with pytest.raises(FvslamError, match="needs a reference"):
        fvslam_graph.evaluate(run.online)
    with pytest.raises(FvslamError, match="the alignment is one of none, origin, se3, sim3, not 'se4'"):
        fvslam_graph.evaluate(run, align="se4")
    with pytest.raises(AttributeError, match="has no attribute 'fly'"):
        fvslam_graph.fly  # noqa: B018


def test_compare(tmp_path, undrawn):
    outcome = fvslam_graph.compare(SHORT, ["vo"], [3], settings={"features.count": [200, 300]}, out=tmp_path)
    assert outcome.table["variant"].tolist() == ["features.count=200", "features.count=300"]
    assert outcome.table["seed"].tolist() == [3, 3] and outcome.table["ape"].nunique() == 2
    assert (tmp_path / "report.html").is_file()


def test_files_are_paired_as_on_the_command_line(tmp_path, fvslam):
    """A KITTI file has no stamps: row by row it belongs to the other one, which has ten poses a second."""
    truth = flight(0.1 * np.arange(60))
    truth.write_tum(tmp_path / "truth.tum")
    truth.from_origin().write_kitti(tmp_path / "poses.kitti")
    for estimated in (
        tmp_path / "poses.kitti",
        str(tmp_path / "poses.kitti"),
        Trajectory.read(tmp_path / "poses.kitti"),
    ):
        evaluation = fvslam_graph.evaluate(estimated, str(tmp_path / "truth.tum"), "none")
        assert (len(evaluation.pairs.indices), evaluation.poses) == (60, 60)
        assert evaluation.scale == pytest.approx(1)
    out = fvslam("evaluate", tmp_path / "poses.kitti", "--reference", tmp_path / "truth.tum", "--align", "none").out
    assert "60 of 60 poses" in out and f"RMSE {evaluation.errors['ape_trans'].stats['rmse']:.4g} m" in out


def test_the_clock_of_the_estimate_may_be_another(tmp_path, fvslam):
    flight(0.1 * np.arange(60)).write_tum(tmp_path / "estimate.tum")
    flight(0.1 * np.arange(60), late=1000.0).write_tum(tmp_path / "truth.tum")
    with pytest.raises(FvslamError, match=r"--time-offset SECONDS.*1000\.000 if both begin together"):
        fvslam_graph.evaluate(tmp_path / "estimate.tum", tmp_path / "truth.tum")
    evaluation = fvslam_graph.evaluate(tmp_path / "estimate.tum", tmp_path / "truth.tum", "none", time_offset=1000)
    assert evaluation.errors["ape_trans"].stats["max"] < 1e-9
    assert "1000 s are added to the stamps of the estimate" in evaluation.notes
    files = tmp_path / "estimate.tum", "--reference", tmp_path / "truth.tum"
    assert "60 of 60 poses" in fvslam("evaluate", *files, "--time-offset", 1000).out
    assert "must be a number of seconds, not nan" in fvslam("evaluate", *files, "--time-offset", "nan").err


def test_what_was_read_otherwise_than_written_is_noted(tmp_path, fvslam):
    path, lost = tmp_path / "truth.tum", tmp_path / "lost.tum"
    flight(0.1 * np.arange(60)).write_tum(path)
    lines = path.read_text().splitlines()
    lost.write_text("\n".join([*lines[:20], *("nan " * 8 for _ in range(20)), *lines[40:]]))
    note = "lost.tum: 20 of 60 poses have a number that is not finite and are left out"
    assert note in fvslam_graph.evaluate(path, lost).notes
    out = " ".join(fvslam("evaluate", path, "--reference", lost).out.split())
    assert "40 of 60 poses" in out and note in out

    flight(np.arange(6) + 0.004).write_tum(lost)
    assert "the stamps of estimate and reference are up to 4 ms apart" in fvslam_graph.evaluate(path, lost).notes
    flight(np.arange(0, 60, 0.9)).write_tum(lost)
    assert any(note.startswith("only 7 of 60 poses") for note in fvslam_graph.evaluate(path, lost).notes)


def test_positions_that_are_none(tmp_path, fvslam):
    path, far = tmp_path / "truth.tum", tmp_path / "far.tum"
    flight(np.arange(5.0)).write_tum(path)
    far.write_text("".join(f"{stamp} 0 {1e10 * stamp} 0 0 0 0 1\n" for stamp in range(5)))
    code, out, err = fvslam("evaluate", path, "--reference", far)
    assert (code, out) == (1, "") and "the reference has a position 4e+10 m away" in err and err.count("\n") == 1


def flight(stamps, late=0.0):
    """Some ten metres a second to the left, the camera turned by a right angle."""
    rotation, known = gtsam.Rot3.Rz(np.pi / 2), np.asarray(stamps)
    positions = np.column_stack([-10 * known, np.sin(known), known**2])
    return Trajectory(known + late, tuple(gtsam.Pose3(rotation, position) for position in positions))


def test_folders_may_be_strings(tmp_path):
    assert fvslam_graph.run(SHORT, out=str(tmp_path / "run")).folder == tmp_path / "run"
    fvslam_graph.compare(SHORT, ["vo"], 1, out=str(tmp_path / "compare"))
    assert (tmp_path / "compare" / "report.html").is_file()


@pytest.mark.parametrize("align", ["se4", "", None, 3])
def test_a_wrong_alignment_is_one_sentence(tmp_path, align):
    truth = open_sequence(SHORT).ground_truth
    with pytest.raises(FvslamError, match="align"):
        fvslam_graph.evaluate(truth, truth, align)
    with pytest.raises(FvslamError, match="align"):
        fvslam_graph.compare(SHORT, align=align, out=tmp_path / "compare")
    assert not (tmp_path / "compare").exists()


@pytest.fixture(scope="module")
def flown():
    return rendered("uav", frames=24, size="320x240")


@pytest.mark.parametrize("mode", list(Mode))
def test_frames_handed_over_one_by_one_give_the_poses_of_a_run(flown, mode):
    """Also where the driver writes every image into the same memory."""
    run = fvslam_graph.run(flown, mode)
    estimator = fvslam_graph.Estimator(flown.camera, mode, flown.ground)
    memory = np.empty_like(flown.load(0))
    for index, stamp in enumerate(flown.stamps):
        memory[:] = flown.load(index)
        result = estimator.step(memory, stamp, flown.ground.heights[index])
        assert np.array_equal(result.pose.mean.matrix(), run.online.poses[index].matrix())
        assert np.array_equal(result.relative.covariance, run.relatives.covariances[index])
        assert (result.index, result.status) == (index, run.frames["status"][index])
    ending = estimator.finish()
    assert (ending is None) == (mode != Mode.GRAPH)
    if ending is not None:
        assert np.array_equal(ending.smoothed.matrices, run.smoothed.matrices)


def test_an_estimator_rectifies_what_a_lens_has_bent(flown):
    """Nearly: twice resampled images are blurred."""
    lens = replace(flown.camera, distortion=Distortion.RADTAN, coefficients=(-0.2, 0.05, 0.0, 0.0))
    plane = np.stack(np.meshgrid(np.arange(320.0), np.arange(240.0)), axis=-1).reshape(-1, 2)
    camera = flown.camera
    seen = lens.normalize(plane) * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    maps = np.moveaxis(seen.reshape(240, 320, 2).astype(np.float32), -1, 0)
    ends = []
    for source, bent in ((camera, False), (lens, True)):
        estimator = fvslam_graph.Estimator(source, "vo", Ground.below(pitch=np.pi / 2))
        for index, stamp in enumerate(flown.stamps[:12]):
            image = flown.load(index)
            image = cv2.remap(image, *maps, cv2.INTER_LINEAR) if bent else image
            result = estimator.step(image, stamp, flown.ground.heights[index])
        ends.append(result.pose.mean)
    apart = np.linalg.norm(ends[0].between(ends[1]).translation())
    assert apart < 0.05 * np.linalg.norm(ends[0].translation())  # measured 0.0


def test_what_cannot_be_a_next_frame(flown):
    estimator = fvslam_graph.Estimator(flown.camera, "average")
    image = flown.load(0)
    assert estimator.step(image, 1.0).status is Status.STATIC
    for wrong, stamp, said in (
        (image, 1.0, "stamps are seconds that increase; 1 comes after 1"),
        (image, np.nan, "stamps are seconds that increase"),
        (image[:100], 2.0, r"array of uint8 \(240, 320\), not uint8 \(100, 320\)"),
        (image.astype(float), 2.0, "not float64"),
        ("image.png", 2.0, "not str"),
    ):
        with pytest.raises(EstimationError, match=said):
            estimator.step(wrong, stamp)
    assert estimator.step(None, 1.1).status is Status.SKIPPED
    assert estimator.finish() is None
    for late in (lambda: estimator.step(image, 3.0), estimator.finish):
        with pytest.raises(EstimationError, match="finished"):
            late()
    with pytest.raises(ConfigError, match="oracle"):
        fvslam_graph.Estimator(flown.camera, settings={"scale.source": "oracle"})


def test_measurements_beside_the_image(flown):
    """Positions handed to an estimator place it on Earth; gravity along the normal of the ground changes little."""
    places = LocalFrame(PLACE).geodetic(true_enu(flown.ground_truth))
    estimator = fvslam_graph.Estimator(flown.camera, "graph", flown.ground)
    for index, (stamp, place) in enumerate(zip(flown.stamps, places, strict=True)):
        position = (*place, 0.02)
        result = estimator.step(flown.load(index), stamp, flown.ground.heights[index], position, flown.ground.normal)
    placement = estimator.finish().placement
    assert placement.origin == pytest.approx(places[0])
    error = result.enu.mean.translation() - LocalFrame(places[0]).enu(places[-1:])[0]
    assert np.linalg.norm(error) < 0.2  # measured: 0.02 m
    assert np.sqrt(np.diag(result.enu.covariance)[3:]).max() < 0.3


@pytest.mark.parametrize(
    ("mode", "position", "gravity", "complaint"),
    [
        ("vo", (49, 8, 100, 1), None, "mode graph"),
        ("graph", (49, 8, 100), None, "standard deviation"),
        ("graph", (49, 8, 100, 0), None, "standard deviation"),
        ("graph", (149, 8, 100, 1), None, "standard deviation"),
        ("graph", (np.nan, 8, 100, 1), None, "standard deviation"),
        ("graph", None, (0, 0, 0), "direction of three numbers"),
        ("graph", None, (0, np.inf, 0), "direction of three numbers"),
    ],
)
def test_measurements_that_are_none(flown, mode, position, gravity, complaint):
    estimator = fvslam_graph.Estimator(flown.camera, mode, flown.ground)
    with pytest.raises(EstimationError, match=complaint):
        estimator.step(None, 0.0, position=position, gravity=gravity)


def test_positions_need_metres(flown):
    with pytest.raises(EstimationError, match="known ground"):
        fvslam_graph.Estimator(flown.camera, "graph").step(None, 0.0, position=(49, 8, 100, 1))


def test_what_is_shown_of_objects_is_short(drive):
    sequence = open_sequence(drive)
    assert repr(sequence) == "Sequence('drive', folder, 12 frames, 320x100 pixels)"
    run = fvslam_graph.run(sequence)
    assert repr(run).startswith("Run('drive-vo', vo on drive, finished, 12 poses of 12 frames, ")
    assert re.fullmatch(r"Trajectory\(12 poses in 1\.1 s, [\d.]+ m\)", repr(run.online))
    evaluation = fvslam_graph.evaluate(run)
    assert re.fullmatch(r"Evaluation\('drive-vo', se3, APE \S+ m, RPE \S+ m, 12 of 12 poses\)", repr(evaluation))
    assert run._repr_html_().startswith("<table>") and "12 of 12 poses" in evaluation._repr_html_()


def test_what_is_shown_of_a_study_is_short():
    row = {"sequence": "<03>", "mode": "vo", "preset": "tuned", "seed": 0, "status": "finished", "ape": 0.1}
    results = StudyResults.of([row], Alignment.SIM3)
    shown = "StudyResults(1 modes on 1 sequences, 1 of 1 runs came to their end, sim3 alignment)"
    assert repr(results) == shown
    assert "<td>0.100</td>" in results._repr_html_() and "<03>" not in results._repr_html_()
