"""Files for Rerun's viewer, opened again by Rerun's own reader."""

import sys
from collections import defaultdict

import numpy as np
import pytest

from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import FvslamError, ResultsError
from fvslam_graph.evaluation import viewer
from fvslam_graph.evaluation.replay import show_run
from fvslam_graph.evaluation.viewer import Viewer
from fvslam_graph.pipeline import run_sequence
from fvslam_graph.runs.frame_files import LANDMARKS
from fvslam_graph.runs.landmark_table import read_landmarks_by_frame
from fvslam_graph.runs.run_folder import read_run
from fvslam_graph.sequences.open import open_sequence

FRAMES = 12
EACH_FRAME = {viewer.CAMERA, viewer.IMAGE, viewer.TRACKS, viewer.SEEN, viewer.ELLIPSOID, viewer.SCALE, viewer.FEATURES}


class Reopened:
    """What a file holds: `rows[entity]` with the columns of each row by name, and the names of static columns."""

    def __init__(self, path):
        chunk = pytest.importorskip("rerun.chunk")
        reader = chunk.RrdReader(str(path))
        self.blueprints = len(reader.blueprints())
        self.rows, self.static = defaultdict(list), defaultdict(set)
        for piece in reader.stream():
            entity, batch = piece.entity_path.removeprefix("/"), piece.to_record_batch()
            if piece.is_static:
                self.static[entity] |= set(batch.schema.names)
            else:
                rows = batch.to_pylist()
                self.rows[entity] += [{name.rpartition(":")[2]: row[name] for name in row} for row in rows]

    def column(self, entity, name):
        """The values of a column in the order of frames, those that are there."""
        rows = sorted(self.rows[entity], key=lambda row: row[viewer.FRAME])
        return [row[name] for row in rows if row.get(name) is not None]


@pytest.fixture(scope="module")
def recorded(drive, tmp_path_factory):
    """A run in mode graph, and the file of it."""
    pytest.importorskip("rerun")
    out = tmp_path_factory.mktemp("viewer")
    sequence = open_sequence(drive)
    config = load_config(settings=["mode=graph", "slam.min_landmarks=10"])
    with Viewer(str(out / "run.rrd"), "drive", sequence.camera, sequence.ground_truth) as shown:
        run = run_sequence(shown.watched(sequence), config, out / "run", shown.watch)
        shown.end(run.smoothed)
    return run, Reopened(out / "run.rrd")


def test_every_frame_is_on_the_timeline_of_the_recording(recorded):
    run, reopened = recorded
    assert reopened.blueprints == 1
    for entity in EACH_FRAME:
        assert reopened.column(entity, viewer.FRAME) == list(range(FRAMES)), entity
        seconds = [time.total_seconds() for time in reopened.column(entity, viewer.TIME)]
        assert seconds == pytest.approx(run.online.stamps.tolist(), abs=1e-6)
    assert len(reopened.rows[viewer.ONLINE]) == FRAMES - 1
    assert {viewer.SMOOTHED, viewer.TRUTH, viewer.IMAGE, "world"} <= set(reopened.static)


def test_poses_and_covariances_are_those_of_the_run(recorded):
    run, reopened = recorded
    translations = np.array(reopened.column(viewer.CAMERA, "translation"))[:, 0]
    assert np.allclose(translations, run.online.positions, atol=1e-5)  # 32 bits
    assert np.allclose(np.array(reopened.column(viewer.ELLIPSOID, "centers"))[:, 0], run.online.positions, atol=1e-5)
    half_sizes = np.sort(np.array(reopened.column(viewer.ELLIPSOID, "half_sizes"))[:, 0], axis=1)
    sigmas = np.sqrt(np.maximum(np.linalg.eigvalsh(run.pose_covariances[:, 3:, 3:]), 0))
    assert np.allclose(half_sizes, 2 * sigmas, rtol=1e-4, atol=1e-6)


def test_tracks_and_landmarks_are_those_of_the_run(recorded):
    run, reopened = recorded
    counts = [len(tracks or []) for tracks in reopened.column(viewer.TRACKS, "vectors")]
    assert counts == run.frames["inliers"].tolist()
    table = read_landmarks_by_frame(run.folder / LANDMARKS)
    assert reopened.column(viewer.POINTS, viewer.FRAME) == sorted(table)
    classes = reopened.column(viewer.POINTS, "class_ids")
    for columns, shown in zip(table.values(), classes, strict=True):
        kept = columns["outcome"][np.isfinite(columns["x"])]
        known = [list(viewer.OUTCOMES).index(outcome) for outcome in kept if outcome in viewer.OUTCOMES]
        assert sorted(shown) == sorted(known)
    assert sum(map(len, classes)) > 10


def test_images_are_jpegs(recorded):
    _, reopened = recorded
    blobs = [bytes(blob[0]) for blob in reopened.column(viewer.IMAGE, "blob")]
    assert len(blobs) == FRAMES
    assert all(blob.startswith(b"\xff\xd8") and len(blob) < 320 * 100 / 2 for blob in blobs)


@pytest.mark.parametrize("with_images", [True, False])
def test_a_finished_run_is_shown_as_it_was(recorded, tmp_path, with_images):
    run, live = recorded
    shown = run if with_images else read_run(run.folder)
    if not with_images:
        shown.info["source"] = None
    notes = show_run(shown, run.folder, str(tmp_path / "plot.rrd"))
    assert [note.partition(":")[0] for note in notes] == ([] if with_images else ["without images"])
    again = Reopened(tmp_path / "plot.rrd")
    assert set(again.rows) == set(live.rows)
    for entity, name in ((viewer.CAMERA, "translation"), (viewer.POINTS, "class_ids"), (viewer.STATUS, "text")):
        assert again.column(entity, name) == live.column(entity, name)
    assert len(again.column(viewer.IMAGE, "blob")) == (FRAMES if with_images else 0)


@pytest.mark.parametrize(
    ("name", "error"), [("run.txt", "files end with .rrd"), ("there.rrd", "exists"), ("absent/run.rrd", "cannot be")]
)
def test_files_that_are_not_written(drive, tmp_path, name, error):
    pytest.importorskip("rerun")
    (tmp_path / "there.rrd").write_bytes(b"mine")
    with pytest.raises(ResultsError, match=error):
        Viewer(str(tmp_path / name), "drive", open_sequence(drive).camera)
    assert (tmp_path / "there.rrd").read_bytes() == b"mine"


def test_the_commands(drive, tmp_path, fvslam, undrawn):
    pytest.importorskip("rerun")
    assert fvslam("run", drive, "--out", tmp_path / "run", "--frames", "0:3", "--rerun", tmp_path / "a.rrd").code == 0
    assert fvslam("plot", tmp_path / "run", "--rerun", tmp_path / "b.rrd").code == 0
    for name in ("a.rrd", "b.rrd"):
        assert Reopened(tmp_path / name).column(viewer.IMAGE, viewer.FRAME) == [0, 1, 2]
    code, _, err = fvslam("run", drive, "--out", tmp_path / "other", "--rerun", tmp_path / "a.rrd")
    assert code == 1 and "exists and is not overwritten" in err and not (tmp_path / "other").exists()


def test_without_rerun_one_sentence_names_the_extra(drive, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(FvslamError, match=r"fvslam-graph\[rerun\]"):
        Viewer(str(tmp_path / "run.rrd"), "drive", open_sequence(drive).camera)


def test_what_goes_wrong_while_it_shows_ends_the_run(recorded, tmp_path, monkeypatch):
    """A thread shows frames."""

    def fail(*_):
        raise RuntimeError("no image")

    monkeypatch.setattr(viewer.Viewer, "_show_image", fail)
    with pytest.raises(RuntimeError, match="no image"):
        show_run(recorded[0], tmp_path, str(tmp_path / "run.rrd"))
