"""`fvslam live`, on folders that are filled while it runs."""

import importlib.util
import json
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest

from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import ConfigError
from fvslam_graph.pipeline import run_live, run_sequence
from fvslam_graph.runs.pose_lines import pose_line
from fvslam_graph.runs.run_folder import read_run
from fvslam_graph.sequences.live import open_live
from fvslam_graph.sequences.open import open_sequence

RERUN = importlib.util.find_spec("rerun") is not None
START = 1_700_000_000


class Recorder:
    """Copies images of a recording to a folder that is watched, named by their stamps."""

    def __init__(self, recording, folder):
        self.folder = folder
        (folder / "images").mkdir(parents=True)
        shutil.copy(recording / "camera.yaml", folder)
        self.stamps = {f"{START + number / 10:.1f}.png": START + number / 10 for number in range(12)}
        self.images = [(name, recording / "images" / f"{number:02d}.png") for number, name in enumerate(self.stamps)]

    def record(self, count=1):
        """Record the next images; False where there are none any more."""
        for name, image in self.images[:count]:
            shutil.copy(image, self.folder / "images" / name)
        count, self.images = len(self.images), self.images[count:]
        return count > 0


@pytest.fixture
def recorder(drive, tmp_path):
    return Recorder(drive, tmp_path / "flight")


@pytest.mark.parametrize("mode", ["average", "graph"])
def test_poses_are_those_of_a_run_on_the_frames_that_were_taken(recorder, tmp_path, mode):
    config = load_config(settings=[f"mode={mode}", "slam.min_landmarks=10"])
    camera = open_live(str(recorder.folder), camera_height=1.65)

    def watch(results):
        for result in results:
            yield result
            if not recorder.record(2 if result.index == 4 else 1):
                camera.stop()

    recorder.record()
    with camera:
        run_live(camera, camera.sequence, config, tmp_path / "live", watch)
    live = read_run(tmp_path / "live")
    assert 11 <= len(live.online) == camera.taken == 12 - camera.dropped
    assert (live.info["status"], live.info["format"], live.info["sequence"]) == ("finished", "live", "flight")

    taken = [name for name, stamp in recorder.stamps.items() if stamp in live.online.stamps]
    rows = "".join(f"{name},{recorder.stamps[name]!r}\n" for name in taken)
    (recorder.folder / "times.csv").write_text(f"filename,timestamp_s\n{rows}")
    run_sequence(open_sequence(recorder.folder, camera_height=1.65), config, tmp_path / "run")
    for name in ("trajectory_online.tum", "covariances.npz", "landmarks.csv", "config.yaml"):
        assert (tmp_path / "live" / name).read_bytes() == (tmp_path / "run" / name).read_bytes()
    assert (tmp_path / "live" / "trajectory_smoothed.tum").exists() == (mode == "graph")


def test_the_scale_source_oracle_needs_a_truth(recorder):
    camera = open_live(str(recorder.folder))
    recorder.record()
    with camera, pytest.raises(ConfigError, match="no ground truth"):
        run_live(camera, camera.sequence, load_config(settings=["scale.source=oracle"]))


def test_formats_of_lines():
    with pytest.raises(ConfigError, match="must be tum or json, not 'xml'"):
        pose_line("xml")


@pytest.mark.parametrize("end", ["Ctrl-C", "nobody reads"])
def test_the_command_ends_with_a_complete_run(recorder, tmp_path, end):
    out, shown = tmp_path / "run", tmp_path / "run.rrd"
    options = ["--format", "json", "--out", out, *(["--rerun", shown] if end == "Ctrl-C" and RERUN else [])]
    process = subprocess.Popen(
        [sys.executable, "-m", "fvslam_graph", "live", *map(str, [recorder.folder, *options])],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        assert process.stderr.readline() == "waiting for images from flight; Ctrl-C ends\n"
        lines = []
        for _ in range(3):
            recorder.record()
            lines.append(json.loads(process.stdout.readline()))
        if end == "Ctrl-C":
            process.send_signal(signal.SIGINT)
        else:
            process.stdout.close()
            recorder.record()
        assert process.wait(60) == 0
        relative, summary = process.stderr.read().splitlines()
    frames = 4 if end == "nobody reads" else 3
    assert relative == "flight: no ground is known, so the scale is relative (scale source 'map')"
    assert summary.startswith(f"flight: {frames} frames, 0 dropped; latency ")
    run = read_run(out)
    assert (run.info["status"], len(run.online)) == ("finished", frames)
    assert shown.exists() == ("--rerun" in options)
    for index, line in enumerate(lines):
        assert (line["frame"], line["stamp"]) == (index, pytest.approx(START + index / 10, abs=1e-6))
        assert line["status"] == run.frames["status"][index]
        assert np.array_equal(line["position"], run.online.positions[index])
        assert np.array_equal(line["covariance"], run.pose_covariances[index])
        assert np.linalg.norm(line["quaternion"]) == pytest.approx(1)


def test_what_libraries_print_is_not_among_the_poses():
    """GTSAM prints on the standard output where a landmark comes to lie behind a camera."""
    code = (
        "import os\n"
        "from fvslam_graph.cli.live import _poses_alone\n"
        "with _poses_alone() as lines:\n"
        "    os.write(1, b'Landmark 7 behind camera\\n')\n"
        "    print('0.1 pose', file=lines, flush=True)\n"
        "os.write(1, b'end\\n')\n"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout == "0.1 pose\nend\n"
    assert said.stderr == "Landmark 7 behind camera\n"
