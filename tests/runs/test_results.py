"""A run folder is written as the run goes on, and read back whatever happened to the run."""

import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import gtsam
import numpy as np
import pytest
from pydantic import BaseModel

from fvslam_graph.core.errors import ResultsError, TrajectoryError
from fvslam_graph.core.frame_result import Ending, FrameResult
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.trajectory import Status, Trajectory
from fvslam_graph.runs.run_folder import RunWriter, read_run

STEP = gtsam.Pose3(gtsam.Rot3.Ypr(0.02, 0.01, -0.01), np.array([0.1, 0.0, 1.0]))
FACTS = {"sequence": "test", "frames": 5, "mode": "vo", "scale_source": "plane", "seed": 7, "sigma": float("nan")}


class Settings(BaseModel):
    detector: str = "fast"
    threshold: float = 0.25
    folder: Path = Path("images")


def frame(index: int) -> FrameResult:
    pose = gtsam.Pose3()
    for _ in range(index):
        pose = pose * STEP
    covariance = np.diag(np.arange(1.0, 7.0)) * index if index else np.full((6, 6), np.nan)
    status = Status.COASTED if index == 3 else Status.TRACKED
    measures = {"tracks": 100 + index, "scale": 1.5 if index else float("nan")}
    times = {"detect": 2.0 + index, "pose": 5.0}
    world = GaussianPose(pose, index * np.eye(6))
    relative = GaussianPose(STEP, covariance)
    return FrameResult(index, 0.1 * index, world, status, max(index - 1, 0), relative, measures, times)


def write(folder: Path, count: int = 5, ground_truth: Trajectory | None = None) -> Path:
    with RunWriter(folder, Settings(), FACTS, ground_truth) as writer:
        for index in range(count):
            writer.add(frame(index))
    return folder


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    truth = Trajectory(np.array([0.0, 0.25]), (gtsam.Pose3(), STEP))
    run = read_run(write(tmp_path / "a" / "run", ground_truth=truth))

    assert run.name == "run"
    assert np.array_equal(run.online.stamps, [0.0, 0.1, 0.2, 0.3, 0.4])
    assert all(pose.equals(frame(i).pose.mean, 1e-12) for i, pose in enumerate(run.online.poses))
    assert np.array_equal(run.frames["tracks"], [100, 101, 102, 103, 104])
    assert run.frames["status"].tolist() == ["tracked"] * 3 + ["coasted", "tracked"]
    assert np.isnan(run.frames["scale"]).tolist() == [True] + [False] * 4
    assert run.frames["detect_ms"].tolist() == [2, 3, 4, 5, 6]
    assert run.config == {"detector": "fast", "threshold": 0.25, "folder": "images"}
    assert run.smoothed is None
    assert run.ground_truth is not None and run.ground_truth.poses[1].equals(STEP, 1e-12)
    assert run.relatives is not None
    assert run.relatives.previous.tolist() == [0, 0, 1, 2, 3]
    assert np.array_equal(run.relatives.covariances[4], 4 * np.diag(np.arange(1.0, 7.0)))
    assert np.isnan(run.relatives.covariances[0]).all()
    assert np.allclose(run.relatives.prev_T_cur[2], STEP.matrix(), atol=0)
    kitti = Trajectory.read_kitti(run.folder / "trajectory_online.kitti")
    assert np.allclose(kitti.matrices, run.online.matrices, atol=1e-12)


def test_run_json_says_how_the_run_was_made(tmp_path: Path) -> None:
    info = read_run(write(tmp_path)).info
    assert info["status"] == "finished"
    assert (info["seed"], info["sigma"]) == (7, None)
    assert set(info["versions"]) == {"fvslam_graph", "python", "gtsam", "numpy", "opencv", "poselib"}
    assert info["machine"]["cores"] >= 1
    totals = info["totals"]
    assert (totals["frames"], totals["statuses"]) == (5, {"tracked": 4, "coasted": 1})
    assert totals["ms_per_frame"]["detect"] == {"median": 4, "mean": 4}
    assert totals["ms_per_frame"]["total"] == {"median": 9, "mean": 9}
    assert 20 < totals["peak_memory_mb"] < 10_000
    assert 0 < totals["seconds"] < 60


def test_every_frame_is_in_the_files_at_once(tmp_path: Path) -> None:
    with RunWriter(tmp_path, Settings(), FACTS) as writer:
        assert len(read_run(tmp_path).online) == 0
        for index in range(3):
            writer.add(frame(index))
            run = read_run(tmp_path)
            assert len(run.online) == len(run.frames["tracks"]) == index + 1
            assert run.info["status"] == "running"
            assert run.relatives is not None and len(run.relatives.previous) == len(run.pose_covariances) == index + 1
            assert run.relatives.covariances[index] == pytest.approx(frame(index).relative.covariance, nan_ok=True)
    assert not (tmp_path / "poses.bin").exists()


def test_the_incomplete_last_pose_of_a_killed_run_is_left_out(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "run", Settings(), FACTS) as writer:
        writer.add(frame(0))
        writer.add(frame(1))
        shutil.copytree(tmp_path / "run", tmp_path / "killed")
    poses = tmp_path / "killed" / "poses.bin"
    poses.write_bytes(poses.read_bytes()[:-4])
    run = read_run(tmp_path / "killed")
    assert run.relatives is not None and len(run.relatives.previous) == len(run.online) == 1
    write(tmp_path / "killed")
    assert not poses.exists()


@pytest.mark.parametrize("damaged", ["trajectory_online.tum", "frames.csv"])
def test_the_incomplete_last_line_of_a_killed_run_is_left_out(tmp_path: Path, damaged: str) -> None:
    path = write(tmp_path) / damaged
    path.write_text(path.read_text()[:-4])
    run = read_run(tmp_path)
    assert len(run.online) == len(run.frames["index"]) == 4


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (KeyboardInterrupt(), "interrupted"),
        (ValueError("no such thing"), "failed: no such thing"),
        (MemoryError(), "failed: MemoryError"),
    ],
)
def test_a_stopped_run_is_kept_and_says_so(tmp_path: Path, error: BaseException, status: str) -> None:
    with pytest.raises(type(error)), RunWriter(tmp_path, Settings(), FACTS) as writer:
        writer.add(frame(0))
        writer.add(frame(1))
        raise error
    run = read_run(tmp_path)
    assert run.info["status"] == status
    assert run.info["totals"]["frames"] == len(run.online) == 2
    assert run.relatives is not None


def test_a_run_without_frames_is_readable(tmp_path: Path) -> None:
    run = read_run(write(tmp_path, count=0))
    assert (len(run.online), run.frames, run.info["totals"]["frames"]) == (0, {}, 0)


def test_the_same_run_gives_the_same_files(tmp_path: Path) -> None:
    write(tmp_path / "a")
    write(tmp_path / "b")
    for name in ("trajectory_online.tum", "trajectory_online.kitti", "frames.csv", "config.yaml", "covariances.npz"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_a_new_run_replaces_the_old_one_and_what_was_said_about_it(tmp_path: Path) -> None:
    write(tmp_path)
    for stale in ("metrics.json", "ape_trans.zip", "plot_error.png", "trajectory_smoothed.tum", "ground_truth.tum"):
        (tmp_path / stale).write_text("old")
    (tmp_path / "notes.txt").write_text("mine")
    write(tmp_path, count=2)
    assert len(read_run(tmp_path).online) == 2
    names = {path.name for path in tmp_path.iterdir()}
    assert "notes.txt" in names
    assert not names & {
        "metrics.json",
        "ape_trans.zip",
        "plot_error.png",
        "trajectory_smoothed.tum",
        "ground_truth.tum",
    }


def test_a_folder_with_other_files_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "frames.csv").write_text("mine")
    with pytest.raises(ResultsError, match="not of a run"):
        write(tmp_path)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]


def test_a_folder_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsError, match=r"file.* cannot be written: Not a directory") as caught:
        write(tmp_path / "file" / "run")
    assert "\n" not in str(caught.value)


def test_a_folder_without_a_run_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match=r"run\.json"):
        read_run(tmp_path / "absent")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("run.json", "{"),
        ("frames.csv", "index,stamp,status\n0,zero,tracked\n"),
        ("frames.csv", "index,stamp,status\n0\n"),
        ("config.yaml", "a: [1"),
        ("covariances.npz", "zip"),
        ("covariances.npz", "PK\x03\x04"),
        ("covariances.npz", ""),
    ],
)
def test_a_damaged_file_is_one_sentence(tmp_path: Path, name: str, content: str) -> None:
    (write(tmp_path) / name).write_text(content)
    with pytest.raises(ResultsError, match=rf"{name} (cannot be read|is not valid YAML)") as caught:
        read_run(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["frames.csv", "config.yaml", "covariances.npz"])
def test_a_pipe_is_one_sentence(tmp_path: Path, name: str) -> None:
    file = write(tmp_path) / name
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(ResultsError, match=f"{name}.*(no regular file|no file)"):
        read_run(tmp_path)


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    file = write(tmp_path) / "run.json"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert read_run(tmp_path).info["status"] == "finished"


def test_a_damaged_trajectory_is_named(tmp_path: Path) -> None:
    (write(tmp_path) / "trajectory_online.tum").write_text("0 0 0 0 0 0 0\n")
    with pytest.raises(TrajectoryError, match=r"trajectory_online\.tum is neither a TUM file .* it has 7"):
        read_run(tmp_path)


def test_json_of_a_run_is_strict(tmp_path: Path) -> None:
    def refuse(word: str) -> None:
        raise AssertionError(word)

    write(tmp_path)
    json.loads((tmp_path / "run.json").read_text(), parse_constant=refuse)


class Stopped:
    """An ending at which something happens."""

    def __init__(self, stop: BaseException | None = None) -> None:
        self.stop = stop
        self.status: str | None = None

    def __call__(self) -> Ending:
        smoothed = Trajectory(np.array([0.0, 0.1]), (gtsam.Pose3(), STEP))
        return Ending(smoothed, "2 of 5 poses", None, self.write)

    def write(self, folder: Path) -> None:
        self.status = json.loads((folder / "run.json").read_text())["status"]
        if self.stop is not None:
            raise self.stop


def finish(folder: Path, ending: Callable[[], Ending]) -> None:
    with RunWriter(folder, Settings(), FACTS, finish=ending) as writer:
        writer.add(frame(0))


def test_a_run_is_finished_when_all_is_written(tmp_path: Path) -> None:
    ending = Stopped()
    finish(tmp_path, ending)
    assert ending.status == "running"
    run = read_run(tmp_path)
    assert run.info["status"] == "finished" and run.info["smoothed"] == "2 of 5 poses" and len(run.smoothed) == 2


@pytest.mark.parametrize(
    ("stop", "status"),
    [
        (OSError(28, "No space left on device"), "failed: .*No space left on device"),
        (KeyboardInterrupt(), "interrupted"),
        (RuntimeError("x"), "failed: x"),
    ],
)
def test_a_run_whose_end_is_stopped_is_not_finished(tmp_path: Path, stop: BaseException, status: str) -> None:
    with pytest.raises(ResultsError if isinstance(stop, OSError) else type(stop)):
        finish(tmp_path, Stopped(stop))
    run = read_run(tmp_path)
    assert re.fullmatch(status, run.info["status"]) and len(run.online) == 1


def test_the_online_result_stands_where_the_graph_cannot_be_solved(tmp_path: Path) -> None:
    finish(tmp_path, lambda: Ending(None, "not determined: it is singular", None, lambda folder: None))
    run = read_run(tmp_path)
    assert (run.info["status"], len(run.online), run.smoothed) == ("finished", 1, None)
    assert run.info["smoothed"] == "not determined: it is singular"


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), ValueError("no such thing")])
def test_a_finished_run_is_kept_until_the_next_one_is_finished(tmp_path: Path, stop: BaseException) -> None:
    write(tmp_path)
    with pytest.raises(type(stop)), RunWriter(tmp_path, Settings(), FACTS) as writer:
        writer.add(frame(0))
        assert len(read_run(tmp_path).online) == 5
        raise stop
    kept, stopped = read_run(tmp_path), read_run(tmp_path / "unfinished")
    assert (kept.info["status"], len(kept.online), len(stopped.online)) == ("finished", 5, 1)
    assert stopped.info["status"] != "finished"
    write(tmp_path, count=3)
    assert len(read_run(tmp_path).online) == 3 and not (tmp_path / "unfinished").exists()


def test_what_a_killed_writer_was_about_to_replace_is_removed(tmp_path: Path) -> None:
    write(tmp_path)
    (tmp_path / "writing_run.json").write_text("{")
    write(tmp_path)
    assert not list(tmp_path.glob("writing_*"))


def test_the_names_of_what_we_leave_are_exact(tmp_path: Path) -> None:
    write(tmp_path)
    mine = ("plot_mine.png", "ape_mine.zip", "row_mine.json", "plot_landmarks_best.png")
    for name in mine:
        (tmp_path / name).write_text("mine")
    write(tmp_path)
    assert all((tmp_path / name).exists() for name in mine)


def edit(name: str, **entries: object) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        (folder / name).write_text(json.dumps(json.loads((folder / name).read_text()) | entries))

    return damage


def text(name: str, content: str) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        (folder / name).write_text(content)

    return damage


def arrays(**changes: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        with np.load(folder / "covariances.npz") as file:
            held = dict(file)
        np.savez(folder / "covariances.npz", **held | {name: change(held[name]) for name, change in changes.items()})

    return damage


def corrupt(folder: Path) -> None:
    content = bytearray((folder / "covariances.npz").read_bytes())
    content[60:120] = bytes(60)
    (folder / "covariances.npz").write_bytes(content)


@pytest.mark.parametrize(
    ("damage", "complaint"),
    [
        (text("run.json", "null"), r"run\.json cannot be read"),
        (text("run.json", "[" * 5000), r"run\.json cannot be read"),
        (text("run.json", "{}"), r"run\.json cannot be read.* the entry 'status' is missing"),
        (edit("run.json", status=3), r"run\.json .*'status' cannot be 3"),
        (edit("run.json", frames="12"), r"run\.json .*'frames' cannot be '12'"),
        (edit("run.json", frames=-1), r"run\.json .*'frames' cannot be -1"),
        (edit("run.json", down=[0, 0, 0]), r"run\.json .*'down' cannot be .*no direction"),
        (edit("run.json", down="up"), r"run\.json .*'down' cannot be 'up'"),
        (edit("run.json", totals=[]), r"run\.json .*'totals' cannot be \[\]"),
        (text("config.yaml", "3"), r"config\.yaml is not a YAML file"),
        (
            text("frames.csv", "index,stamp,status\n0,7.0,tracked\n"),
            r"and frames\.csv are not of the same",
        ),
        (text("frames.csv", "index,stamp\n0,0.0\n"), r"frames\.csv cannot be read.*no columns"),
        (text("frames.csv", "index,stamp,status\n0,0.0,lost\n"), r"frames\.csv cannot be read.*no status 'lost'"),
        (text("frames.csv", f"index,stamp,status\n{'9' * 40},0,tracked\n"), r"frames\.csv cannot be read"),
        (text("frames.csv", f'index,stamp,status\n"{"9" * 200_000}",0,tracked\n'), r"frames\.csv cannot be read"),
        (corrupt, r"covariances\.npz cannot be read"),
        (arrays(previous=lambda p: p - 3), r"covariances\.npz .*do not fit each other"),
        (arrays(previous=lambda p: p[:-1]), r"covariances\.npz .*do not fit each other"),
        (arrays(covariances=lambda c: c[:, :3]), r"covariances\.npz .*do not fit each other"),
        (arrays(covariances=np.negative), r"covariances\.npz .*frame 1 has a negative variance"),
        (arrays(prev_T_cur=lambda t: np.nan * t), r"covariances\.npz .*motion that is not finite"),
    ],
)
def test_a_run_that_somebody_has_changed_is_one_sentence(
    tmp_path: Path, damage: Callable[[Path], None], complaint: str
) -> None:
    damage(write(tmp_path))
    with pytest.raises(ResultsError, match=complaint) as caught:
        read_run(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_run_that_is_cut_is_as_long_as_its_shortest_file(tmp_path: Path) -> None:
    write(tmp_path)
    lines = (tmp_path / "frames.csv").read_text().splitlines(keepends=True)
    (tmp_path / "frames.csv").write_text("".join(lines[:4]))
    run = read_run(tmp_path)
    assert len(run.online) == len(run.frames["index"]) == len(run.relatives.previous) == 3
    (tmp_path / "frames.csv").write_text("")
    assert len(read_run(tmp_path).online) == 0
