"""Other programs are run, measured, ended, and stand beside ours; what they do wrong is a row."""

import os
import re
import select
import shlex
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pytest
import yaml

import fvslam_graph
from fvslam_graph.core.errors import StudyError
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.study import run as module
from fvslam_graph.study.run import run_study
from fvslam_graph.study.sources import HeldSequence, Source
from fvslam_graph.study.spec import Study, comparison, load_study
from fvslam_graph.study.systems import System, run_systems

# Writes the ground truth at the stamps it is given, but for the first ones, and a line in a diary.
TRUTH = """
    import sys
    images, times, camera, out, truth, skipped = sys.argv[1:]
    open("diary.txt", "a").write("once\\n")
    stamps = [float(line) for line in open(times)]
    assert len(stamps) == len(list(__import__("pathlib").Path(images).iterdir()))
    known = {float(line.split()[0]): line for line in open(truth)}
    nearest = [min(known, key=lambda stamp: abs(stamp - wanted)) for wanted in stamps[int(skipped):]]
    open(out, "w").writelines(known[stamp] for stamp in nearest)
"""


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Makes a command of a Python program; it is run in the folder of the test, as it names no other."""
    monkeypatch.chdir(tmp_path)

    def make(source: str, arguments: str = "{images} {out}") -> str:
        file = tmp_path / f"a program {len(list(tmp_path.glob('a program*')))}.py"
        file.write_text(textwrap.dedent(source))
        return f"{shlex.quote(sys.executable)} {shlex.quote(str(file))} {arguments}"

    return make


@pytest.fixture
def truthful(program, drive):
    return lambda skipped: program(
        TRUTH, f"{{images}} {{times}} {{camera}} {{out}} {shlex.quote(str(drive / 'groundtruth.tum'))} {skipped}"
    )


def rows(drive, folder, limit=60.0, **commands):
    systems = {name: System(command=command) for name, command in commands.items()}
    return [row for row, _ in run_systems([Source(path=str(drive))], systems, limit, Alignment.SIM3, folder)]


def test_it_stands_in_the_table_on_common_frames(drive, tmp_path, truthful, monkeypatch):
    monkeypatch.setattr(module, "draw_study", lambda *arguments: [])
    monkeypatch.setattr(module, "_draw_trajectories", lambda *arguments: [])
    seen = []

    def watch(found, total):
        for number, row in found:
            seen.append((number, total))
            yield number, row

    study = comparison(str(drive), ["vo"], 1, systems={"part": truthful(4)})
    results = run_study(study, tmp_path / "out", 1, watch=watch)
    assert seen == [(0, 2), (1, 2)]
    ours, theirs = results.table.to_dict("records")
    assert (theirs["mode"], theirs["preset"], theirs["status"]) == ("part", "external", "finished")
    assert theirs["ape"] < 1e-6 and (theirs["associated"], theirs["common"], theirs["frames"]) == (8, 8, 12)
    assert ours["common"] == 8 and ours["associated"] == 12 and ours["ape_common"] != ours["ape"]
    assert 0 < theirs["cpu_s"] < 20 and 0 < theirs["wall_s"] < 60 and 3 < theirs["peak_mb"] < 500
    assert min(ours["wall_s"], ours["cpu_s"]) > 0 and np.isnan(theirs["ms"])
    table = results.summary()
    assert {"CPU (s)", "wall (s)"} <= set(table.columns) and "of all their processes" in table.caption
    assert pd.read_csv(tmp_path / "out" / "costs.csv")["wall_s"].notna().all()
    again = yaml.safe_load((tmp_path / "out" / "study.yaml").read_text())["systems"]["part"]
    assert again == {"command": study.systems["part"].command, "folder": str(tmp_path)}
    assert not (tmp_path / "out" / "systems" / "input").exists()


def test_it_is_run_once_for_the_same_command_input_and_limit(drive, tmp_path, truthful):
    command, out = truthful(0), tmp_path / "out"

    def runs() -> int:
        return len((tmp_path / "diary.txt").read_text().splitlines())

    before, after = (pd.DataFrame(rows(drive, out, a=command)) for _ in range(2))
    pd.testing.assert_frame_equal(before, after)  # what it took, too
    assert runs() == 1
    rows(drive, out, limit=61, a=command)
    rows(drive, out, a=command + " ")
    assert runs() == 3
    script = next(tmp_path.glob("a program*"))
    script.write_text(script.read_text() + "\n# changed\n")
    rows(drive, out, a=command)
    assert runs() == 4
    for file in out.glob("*/trajectory.tum"):
        file.write_text("damaged")
    assert rows(drive, out, a=command)[0]["status"].startswith("failed: ") and runs() == 4
    assert rows(drive, out, a=command)[0]["status"] == "finished" and runs() == 5
    rows(drive, out, b="false {images} {out}")
    assert "exit code 1" in rows(drive, out, b="false {images} {out}")[0]["status"]  # tried again


def test_what_it_is_given(drive, tmp_path, program):
    """Rectified images, numbered without gaps, with a time each, and the camera as a plain folder has it."""
    recording = open_sequence(drive)
    sequence = Sequence(
        "gaps",
        "memory",
        recording.camera,
        recording.stamps,
        lambda index: None if index == 3 else recording.load(index),
        recording.ground_truth,
    )
    copy = program(
        """
        import shutil, sys
        images, times, camera, out = sys.argv[1:]
        shutil.copytree(images, "copy/images"), shutil.copy(camera, "copy"), shutil.copy(times, "copy")
        sys.exit("enough\\nseen\\n")
        """,
        "{images} {times} {camera} {out}",
    )
    source = HeldSequence.of(sequence)
    [(row, run)] = run_systems([source], {"copy": System(command=copy)}, 60, Alignment.SIM3, tmp_path / "out")
    assert run is None and row["status"] == "failed: it ended with exit code 1: seen"
    copied = open_sequence(tmp_path / "copy")
    assert copied.camera == recording.camera and len(copied) == 11
    assert (copied.load(3) == recording.load(4)).all()
    kept = [*range(3), *range(4, 12)]
    assert [float(line) for line in (tmp_path / "copy" / "times.txt").read_text().split()] == [
        float(stamp) for stamp in recording.stamps[kept]
    ]
    assert copied.notes[0].startswith("times.csv is missing, the rate is 10 Hz")


ESTIMATOR = """
    import sys
    from pathlib import Path
    import cv2
    import fvslam_graph
    from fvslam_graph.core.trajectory import Trajectory
    from fvslam_graph.sequences.calibration import read_calibration
    images, times, camera, out = map(Path, sys.argv[1:])
    estimator = fvslam_graph.Estimator(read_calibration(camera).camera, mode="vo")
    stamps = [float(line) for line in times.read_text().split()]
    files = sorted(images.iterdir())
    poses = [estimator.step(cv2.imread(str(f), 0), stamp).pose.mean for f, stamp in zip(files, stamps, strict=True)]
    Trajectory(stamps, tuple(poses)).write_tum(out)
"""


def test_our_own_estimator_as_a_program_has_the_same_poses(drive, tmp_path, program):
    """So that images, times and camera are what our modes see."""
    sequence = replace(open_sequence(drive), ground=None)
    command = program(ESTIMATOR, "{images} {times} {camera} {out}")
    systems = {"ours": System(command=command)}
    [(row, run)] = run_systems([HeldSequence.of(sequence)], systems, 60, Alignment.SIM3, tmp_path / "out")
    assert row["status"] == "finished"
    ours = fvslam_graph.run(sequence, mode="vo")
    np.testing.assert_allclose(run.online.matrices, ours.online.matrices, atol=1e-6)
    assert run.online.stamps.tolist() == sequence.stamps.tolist()


@pytest.mark.parametrize(
    ("source", "why"),
    [
        ("print('fine')", "failed: it wrote no trajectory"),
        ("import os; os.abort()", "failed: it ended with exit code -6"),
        ("import sys; open(sys.argv[2], 'w').write('not a pose\\n')", "trajectory.tum"),
        ("import sys; open(sys.argv[2], 'w').write('900 0 0 0 0 0 0 1\\n901 0 0 1 0 0 0 1\\n')", "0 of 2 poses"),
    ],
)
def test_a_failure_is_a_row(drive, tmp_path, program, source, why):
    [row] = rows(drive, tmp_path / "out", bad=program(source))
    assert row["status"].startswith("failed: ") and why in row["status"]
    assert (row["mode"], row["sequence"], row["preset"]) == ("bad", "drive", "external")


def test_what_cannot_be_begun_or_opened(drive, tmp_path):
    [row] = rows(drive, tmp_path / "out", absent="no-such-program {images} {out}")
    assert row["status"] == "failed: it cannot be begun: [Errno 2] No such file or directory: 'no-such-program'"
    [row] = rows(drive, tmp_path / "out", odd="no\0thing {images} {out}")
    assert row["status"] == "failed: it cannot be begun: embedded null byte"
    [row] = rows(tmp_path / "nothing", tmp_path / "out", absent="true {images} {out}")
    assert row["status"].startswith("failed: ") and "nothing" in row["status"]


CHILD = """
    import subprocess, sys, time
    code = "import time; ballast = b'x' * 80_000_000; end = time.process_time() + 0.3\\n"
    code += "while time.process_time() < end: pass\\nprint('ready', flush=True); time.sleep(600)"
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, start_new_session=True)
    child.stdout.readline()
    open("child.txt", "w").write(str(child.pid))
"""


def test_its_children_end_with_it_and_are_counted(drive, tmp_path, program):
    """Also one with a session of its own, whose parent has gone; the row is that of the program."""
    command = program(textwrap.dedent(CHILD) + "open(sys.argv[2], 'w').write('0 0 0 0 0 0 0 1\\n0.1 0 0 1 0 0 0 1\\n')")
    [row] = rows(drive, tmp_path / "out", a=command)
    assert row["status"] == "finished" and row["peak_mb"] > 80 and row["cpu_s"] >= 0.3
    assert not psutil.pid_exists(int((tmp_path / "child.txt").read_text()))


def test_it_is_killed_at_the_limit_with_its_children(drive, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = "sh -c 'sleep 600 & echo $! > child.txt; wait' {images} {out}"
    [row] = rows(drive, tmp_path / "out", limit=2, slow=command)
    assert row["status"] == "failed: it was killed after 2 s, the limit for other systems"
    assert not psutil.pid_exists(int((tmp_path / "child.txt").read_text()))


def test_ctrl_c_ends_it(drive, tmp_path, program):
    command = program(textwrap.dedent(CHILD) + "time.sleep(600)")
    os.mkfifo("child.txt")
    pipe = os.open("child.txt", os.O_RDWR)
    compare = [sys.executable, "-m", "fvslam_graph", "compare", drive, "--modes", "vo", "--seeds", "1", "--out", "out"]
    with subprocess.Popen([*compare, "--system", f"slow={command}"], stderr=subprocess.PIPE, text=True) as fvslam:
        begun = select.select([pipe], [], [], 300)[0]
        fvslam.send_signal(signal.SIGINT)
        error = fvslam.communicate()[1]
    assert begun, error
    assert fvslam.returncode == 130, error
    assert "the same command goes on from there" in error and "Traceback" not in error
    assert not psutil.pid_exists(int(os.read(pipe, 20)))
    os.close(pipe)
    assert not list(Path("out/systems").glob("*/usage.json")) and not Path("out/systems/input").exists()


def test_what_the_user_has_put_in_the_way_stays(drive, tmp_path, truthful):
    """Images of an attempt that was killed are removed; anything else is not."""
    command = truthful(0)
    folder = tmp_path / "out" / "input"
    folder.mkdir(parents=True)
    (folder / "mine.txt").write_text("mine")
    with pytest.raises(Exception, match="input holds files that are not of a set of rendered images"):
        rows(drive, tmp_path / "out", a=command)
    assert (folder / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("command", "complaint"),
    [
        ("slam {images}", "lacks {out}"),
        ("slam {images} {output}", "'{output}' is none of {images}, {out}, {times}, {camera}"),
        ("slam {images} '{out}", "no closing quotation"),
        ("slam {images {out}", "unexpected '{'"),
        ("{images} {out}", "not with a program"),
    ],
)
def test_a_command_that_cannot_be(command, complaint):
    with pytest.raises(StudyError, match=".*".join(map(re.escape, ("systems.x", complaint)))):
        comparison("synthetic:uav", ["vo"], 1, systems={"x": command})


def test_names_and_limits_that_cannot_be(fvslam, drive):
    with pytest.raises(StudyError, match="'vo' is the name of another method"):
        comparison("synthetic:uav", ["vo"], 1, systems={"vo": "slam {images} {out}"})
    with pytest.raises(StudyError, match="system_limit"):
        comparison("synthetic:uav", ["vo"], 1, system_limit=0)
    ended = fvslam("compare", drive, "--system", "ORB-SLAM3")
    assert ended.code == 1 and "--system takes NAME='command {images} {out}', not 'ORB-SLAM3'" in ended.err


def test_in_a_declaration(tmp_path):
    file = tmp_path / "s.yaml"
    file.write_text("sequences: [a]\nmodes: [vo]\nsystem_limit: 9\nsystems:\n  other: ./slam.sh {images} {out}\n")
    study = load_study(file)
    assert study.system_limit == 9
    assert study.systems == {"other": System(command="./slam.sh {images} {out}", folder=str(tmp_path))}
    assert Study.model_validate(study.model_dump(mode="json")) == study


def test_a_sequence_without_ground_truth(drive, tmp_path, truthful):
    sequence = open_sequence(drive)
    blind = HeldSequence.of(Sequence("blind", "memory", sequence.camera, sequence.stamps, sequence.load))
    [(row, run)] = run_systems([blind], {"a": System(command=truthful(0))}, 60, Alignment.SIM3, tmp_path / "out")
    assert row["status"] == "finished" and "ape" not in row and (row["coverage"], len(run.online)) == (1, 12)


STAND_IN = """
    from enum import Enum
    from pathlib import Path
    from types import SimpleNamespace
    import numpy as np
    import gtsam

    Sensor = Enum("Sensor", "MONOCULAR")
    TrackingState = Enum("TrackingState", "NOT_INITIALIZED OK")
    rows = np.loadtxt({truth!r})

    def vocabulary_path():
        return "vocabulary"

    class Slam:
        def __init__(self, vocabulary, settings, sensor):
            assert "Camera1.fx" in Path(settings).read_text() and sensor is Sensor.MONOCULAR
            self.count = 0

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def track_monocular(self, image, stamp):
            assert image.dtype == np.uint8
            self.count += 1
            if self.count in (1, 2, 4):  # the first map has one pose
                return SimpleNamespace(ok=False, pose_wc=None, state=TrackingState.NOT_INITIALIZED)
            x, y, z, qx, qy, qz, qw = rows[np.abs(rows[:, 0] - stamp).argmin(), 1:]
            pose = gtsam.Pose3(gtsam.Rot3.Quaternion(qw, qx, qy, qz), [x, y, z]).matrix().astype(np.float32)
            return SimpleNamespace(ok=True, pose_wc=pose, state=TrackingState.OK)
"""


def test_the_example_of_orb_slam3(drive, tmp_path, monkeypatch):
    """Against a stand-in for its bindings, which knows the ground truth."""
    example = Path(__file__).parents[2] / "examples" / "systems" / "orbslam3.py"
    source = textwrap.dedent(STAND_IN).replace("{truth!r}", repr(str(drive / "groundtruth.tum")))
    (tmp_path / "pyorbslam3.py").write_text(source)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    command = f"{shlex.quote(sys.executable)} {shlex.quote(str(example))} {{images}} {{times}} {{camera}} {{out}}"
    [row] = rows(drive, tmp_path / "out", orb=command)
    assert row["status"] == "finished" and row["ape"] < 1e-4 and row["ape_rot"] < 1e-3
    assert (row["associated"], row["frames"]) == (8, 12)
    assert len(example.read_text().splitlines()) < 40
