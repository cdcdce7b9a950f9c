"""Whatever is wrong with what a user hands in: exit code 1, one sentence on stderr, and nothing on stdout."""

import re
import shutil

import pytest

from fvslam_graph.core.config import load_config
from fvslam_graph.estimator import estimate
from fvslam_graph.pipeline import run_metadata
from fvslam_graph.runs.run_folder import RunWriter
from fvslam_graph.sequences.open import open_sequence

TRUTH = "groundtruth.tum"


@pytest.fixture
def refused(fvslam):
    """Runs a command that must fail with a sentence that matches the complaint."""

    def check(complaint, *arguments):
        code, out, err = fvslam(*arguments)
        assert (code, out) == (1, "")
        assert err.startswith("fvslam: ") and err.endswith("\n") and err.count("\n") == 1
        assert re.search(complaint, err), err

    return check


@pytest.fixture(scope="module")
def finished(drive, tmp_path_factory):
    """A run without ground truth."""
    folder = tmp_path_factory.mktemp("runs") / "finished"
    sequence, config = open_sequence(drive, frames=":4"), load_config()
    with RunWriter(folder, config, run_metadata(sequence, config)) as writer:
        for result in estimate(sequence, config):
            writer.add(result)
    return folder


def empty(recording):
    shutil.rmtree(recording)
    recording.mkdir()


def without_images(recording):
    shutil.rmtree(recording / "images")


def truncated(recording):
    for image in (recording / "images").iterdir():
        image.write_bytes(image.read_bytes()[:1000])


def blank(recording):
    for image in (recording / "images").iterdir():
        image.write_bytes(b"")


def written(name, text):
    def spoil(recording):
        (recording / name).write_text(text)

    return spoil


def edited(name, pattern, replacement):
    def spoil(recording):
        text, count = re.subn(pattern, replacement, (recording / name).read_text(), count=1)
        assert count == 1
        (recording / name).write_text(text)

    return spoil


def swapped(name, row):
    def spoil(recording):
        lines = (recording / name).read_text().splitlines(keepends=True)
        lines[row], lines[row + 1] = lines[row + 1], lines[row]
        (recording / name).write_text("".join(lines))

    return spoil


@pytest.mark.parametrize("command", ["run", "info"])
@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (shutil.rmtree, r"drive does not exist"),
        (empty, r"drive is an empty folder"),
        (without_images, r"drive is no recording of a known format; looked for .*images/ and camera\.yaml"),
        (truncated, r"none of the 12 images can be decoded, the first is .*00\.png"),
        (blank, r"none of the 12 images can be decoded, the first is .*00\.png"),
        (lambda recording: (recording / "camera.yaml").unlink(), r"camera\.yaml is missing"),
        (edited("camera.yaml", "320", "640"), r"00\.png is 320x100 pixels, but .*camera\.yaml is for 640x100"),
        (edited("camera.yaml", r"\[[\d.]+", "[.nan"), r"camera\.yaml: 'camera_matrix' should be 9 numbers"),
        (edited("camera.yaml", r"\[[\d.]+", "[-5"), r"camera\.yaml: the focal lengths must be positive"),
        (written("camera.yaml", "a: [1"), r"camera\.yaml is not valid YAML"),
        (swapped("times.csv", 4), r"times\.csv: stamp 5 of 12 is not later than the one before"),
        (edited("times.csv", r"0\.500", "nan"), r"times\.csv: stamp 6 of 12 is not a finite number"),
        (swapped(TRUTH, 4), r"groundtruth\.tum: .*not later than the one before, at pose 6 of 12"),
        (edited(TRUTH, r"(?m)^0\.3\S+", "soon"), r"groundtruth\.tum: pose 4 is not a row of numbers"),
        (written(TRUTH, ""), r"groundtruth\.tum holds no poses"),
    ],
)
def test_a_damaged_recording(drive, tmp_path, monkeypatch, refused, command, spoil, complaint):
    monkeypatch.chdir(tmp_path)
    spoil(shutil.copytree(drive, tmp_path / "drive"))
    refused(complaint, command, "drive")
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ("--set preset=fast", "'preset' cannot be 'fast': input should be 'paper' or 'tuned'"),
        ("--set vo.min_inlier=20", r"no setting 'vo\.min_inlier'; the nearest is 'vo\.min_inliers'"),
        ("--set vo.min_inliers=2", r"'vo\.min_inliers' cannot be 2"),
        ("--config absent.yaml", r"absent\.yaml is missing"),
        ("--seed -1", "'seed' cannot be -1"),
        ("--frames 5", "frames are given as START:STOP, for example 100:350, not '5'"),
        ("--frames 50:60", "no frame of drive is in 50:60, it has 12"),
        ("--image-scale 2", r"the scale must be in \(0, 1\], not 2"),
        ("--image-scale 0.001", "the image size must be 16 to 10000 pixels a side, not 0x0"),
        ("--camera-height nan", "the camera height must be a positive number of metres, not nan"),
        ("--camera-pitch 9", "the camera pitch must be between -pi/2 and pi/2 radians, not 9"),
    ],
)
def test_a_bad_option_of_run(drive, tmp_path, monkeypatch, refused, options, complaint):
    monkeypatch.chdir(tmp_path)
    refused(complaint, "run", drive, *options.split())
    assert not list(tmp_path.iterdir())


def test_the_oracle_needs_ground_truth(drive, tmp_path, refused):
    recording = shutil.copytree(drive, tmp_path / "drive")
    (recording / TRUTH).unlink()
    complaint = "drive has no ground truth for the scale source 'oracle'"
    refused(complaint, "run", recording, "--out", tmp_path / "run", "--set", "scale.source=oracle")


@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("mars", "there is no synthetic world 'mars'"),
        ("uav?frame=3", "there is no option 'frame'; the nearest is 'frames'"),
        ("uav?frames=0", "the option frames cannot be '0'"),
    ],
)
def test_a_synthetic_world_that_is_none(tmp_path, monkeypatch, refused, name, complaint):
    monkeypatch.chdir(tmp_path)
    refused(complaint, "run", f"synthetic:{name}")


def test_an_output_that_cannot_be_written(drive, tmp_path, refused):
    file = tmp_path / "file"
    file.write_text("mine")
    refused("file cannot be written: File exists", "run", drive, "--out", file)
    refused("file/run cannot be written: Not a directory", "run", drive, "--out", file / "run")
    refused("file/vo-tuned cannot be written: Not a directory", "demo", "--out", file)
    assert file.read_text() == "mine"


def test_an_output_with_other_files_is_left_alone(drive, tmp_path, refused):
    (tmp_path / "notes.txt").write_text("mine")
    refused("holds files that are not of a run", "run", drive, "--out", tmp_path)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]


def test_a_disk_that_fills_up(drive, tmp_path, monkeypatch, refused):
    def full(self, result):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("fvslam_graph.runs.frame_files.tum_line", full)
    refused("run cannot be written: No space left on device", "run", drive, "--out", tmp_path / "run")


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ("evaluate {drive}", r"drive is not the folder of a run: it has no run\.json"),
        ("evaluate {absent}", "absent is missing"),
        ("evaluate {run}", "finished has no ground truth; give a reference"),
        ("evaluate {run} --reference {absent}", "absent is missing"),
        ("evaluate {run} --reference {times}", r"times\.csv holds no poses: no line begins with a number"),
        ("evaluate {truth}", r"groundtruth needs a reference: give the trajectory to compare it with"),
        ("evaluate {truth} --reference {late}", r"0 of 12 poses have a reference: .* from 1000\.000 to 1004"),
        ("plot {drive}", r"drive is not the folder of a run: it has no run\.json"),
        ("plot {run} {absent}", r"absent is not the folder of a run: it has no run\.json"),
        ("plot {run} --out {truth}", r"groundtruth\.tum cannot be written: File exists"),
    ],
)
def test_what_cannot_be_evaluated_or_plotted(drive, finished, tmp_path, refused, arguments, complaint):
    late = tmp_path / "late.tum"
    late.write_text("".join(f"{stamp} 0 0 0 0 0 0 1\n" for stamp in range(1000, 1005)))
    paths = {"drive": drive, "run": finished, "absent": tmp_path / "absent", "truth": drive / TRUTH, "late": late}
    refused(complaint, *(word.format(times=drive / "times.csv", **paths) for word in arguments.split()))


def test_a_damaged_run(finished, tmp_path, refused):
    run = shutil.copytree(finished, tmp_path / "run")
    (run / "frames.csv").write_text("index,stamp,status\n0,zero,tracked\n")
    refused(r"frames\.csv cannot be read, the run must be done again", "plot", run)
    (run / "run.json").write_text("{")
    refused(r"cannot be read, the run must be done again", "evaluate", run)
