"""The commands, from their arguments to the files and the text that they leave."""

import json
import re
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
import typer
import yaml

import fvslam_graph
from fvslam_graph import pipeline
from fvslam_graph.cli import app
from fvslam_graph.core.files import file_name
from fvslam_graph.evaluation.plots import runs as plots
from fvslam_graph.runs.run_folder import FIGURES, read_run

COMMANDS = list(typer.main.get_command(app).commands)
HEAVY = {"gtsam", "cv2", "evo", "matplotlib", "scipy", "numpy", "pandas", "poselib", "dask", "distributed"}


def test_run_evaluate_and_plot(drive, tmp_path, fvslam):
    folder = tmp_path / "run"
    outcome = fvslam("run", drive, "--out", folder)
    assert outcome == (
        0,
        f"12 frames of drive: 11 tracked, 1 static; next: fvslam evaluate {folder}; fvslam plot {folder}\n",
        "",
    )
    run = read_run(folder)
    assert (run.info["status"], len(run.online), run.coverage) == ("finished", 12, 1)
    assert run.config["preset"] == "tuned"

    code, out, err = fvslam("evaluate", folder)
    assert (code, err) == (0, "")
    assert all(word in out for word in ("r_rel", "(deg/100", "APE", "peak"))
    assert max(map(len, out.splitlines())) <= 80
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["alignment"] == "se3"
    assert 11 < metrics["path_length"] < 16
    assert 0.001 < metrics["rpe_trans"]["rmse"] < 0.3  # of steps of 1.2 m
    assert (folder / "ape_trans.zip").is_file()

    code, out, err = fvslam("plot", folder)
    assert (code, err) == (0, "")
    names = {line.rpartition("/")[2] for line in out.splitlines()}
    assert {"plot_trajectory.png", "plot_trajectory.pdf", "plot_error.png", "plot_features.pdf"} <= names
    assert all((folder / name).stat().st_size > 1000 for name in names)


def test_what_can_be_done_next_without_ground_truth(drive, tmp_path, fvslam):
    recording, folder = tmp_path / "drive", tmp_path / "run"
    shutil.copytree(drive, recording, ignore=shutil.ignore_patterns("groundtruth.tum"))
    code, out, _ = fvslam("run", recording, "--frames", ":3", "--out", folder)
    assert code == 0 and out.endswith(f"; next: fvslam export {folder} --to csv; fvslam plot {folder}\n")


def test_options_reach_the_run(drive, tmp_path, fvslam):
    settings = tmp_path / "settings.yaml"
    settings.write_text("features: {count: 300, spacing: 5}\n")
    part = ("--frames", "1:9", "--stride", 2, "--image-scale", 0.5)
    ground = ("--camera-height", 3, "--camera-pitch", 0.1)
    chosen = ("--preset", "paper", "--config", settings, "--set", "features.count=200", "--seed", 5)
    code, _, err = fvslam("run", drive, "--out", tmp_path / "run", *part, *ground, *chosen)
    assert code == 0 and "most frames were not tracked (1 static, 2 coasted, 1 reinitialised)" in err
    run = read_run(tmp_path / "run")
    assert (run.config["preset"], run.config["seed"]) == ("paper", 5)
    assert (run.config["features"]["count"], run.config["features"]["spacing"]) == (200, 5)
    assert run.frames["stamp"].tolist() == pytest.approx([0.1, 0.3, 0.5, 0.7])
    assert run.info["ground"] == "given"
    assert run.info["down"] == pytest.approx([0, np.cos(0.1), np.sin(0.1)])


def test_the_default_folder_needs_no_quotes(tmp_path, monkeypatch, fvslam):
    monkeypatch.chdir(tmp_path)
    code, out, _ = fvslam("run", "synthetic:drive?frames=2&size=320x100")
    folder = f"runs/{file_name('synthetic:drive?frames=2&size=320x100')}-vo-tuned"
    assert re.fullmatch(r"[\w./-]+", folder)
    assert code == 0 and out.endswith(f"fvslam plot {folder}\n")
    assert read_run(tmp_path / folder).info["sequence"] == "synthetic:drive?frames=2&size=320x100"


@pytest.mark.parametrize("preset", ["paper", "tuned"])
def test_the_same_seed_gives_the_same_bits(drive, tmp_path, fvslam, preset):
    for name in ("a", "b"):
        assert fvslam("run", drive, "--out", tmp_path / name, "--preset", preset, "--seed", 3).code == 0
    for name in ("trajectory_online.tum", "trajectory_online.kitti", "covariances.npz"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert read_run(tmp_path / "a").online.path_length > 5


def test_without_known_ground_the_scale_is_relative(drive, tmp_path, fvslam):
    recording = shutil.copytree(drive, tmp_path / "drive")
    (recording / "times.csv").unlink()
    code, _, err = fvslam("run", recording, "--out", tmp_path / "run")
    assert code == 0
    assert err == "drive: no ground is known, so the scale is relative (scale source 'map')\n"
    assert read_run(tmp_path / "run").config["scale"]["source"] == "map"


def test_unreadable_images_are_skipped_and_counted(drive, tmp_path, fvslam):
    recording = shutil.copytree(drive, tmp_path / "drive")
    (recording / "images" / "00.png").unlink()
    image = recording / "images" / "05.png"
    image.write_bytes(image.read_bytes()[:2000])
    (recording / "images" / "06.png").write_bytes(b"")
    code, _, err = fvslam("run", recording, "--out", tmp_path / "run")
    assert (code, err) == (0, "")
    run = read_run(tmp_path / "run")
    assert np.flatnonzero(run.frames["status"] == "skipped").tolist() == [0, 5, 6]
    assert (run.info["status"], run.info["totals"]["statuses"]["skipped"], run.coverage) == ("finished", 3, 1)
    assert fvslam("evaluate", tmp_path / "run").code == 0


def test_an_interrupted_run_is_kept(drive, tmp_path, monkeypatch, fvslam):
    def interrupted(estimator, sequence, through=pipeline.through):
        for result in through(estimator, sequence):
            if result.index == 4:
                raise KeyboardInterrupt
            yield result

    monkeypatch.setattr(pipeline, "through", interrupted)
    code, out, err = fvslam("run", drive, "--out", tmp_path / "run")
    kept = f"stopped: 4 of 12 frames are kept in {tmp_path / 'run'}, which evaluate and plot take; "
    assert (code, out, err) == (130, "", f"{kept}the same command begins anew\n")
    run = read_run(tmp_path / "run")
    assert (run.info["status"], len(run.online), run.info["totals"]["frames"]) == ("interrupted", 4, 4)
    code, out, _ = fvslam("evaluate", tmp_path / "run")
    assert code == 0 and "interrupted" in out and "33.3 %" in out


@pytest.mark.parametrize("stop", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_interrupts(drive, tmp_path, monkeypatch, fvslam, stop):
    def signalled(estimator, sequence, through=pipeline.through):
        for result in through(estimator, sequence):
            if result.index == 4:
                signal.raise_signal(stop)
            yield result

    monkeypatch.setattr(pipeline, "through", signalled)
    outcome = fvslam("run", drive, "--out", tmp_path / "run")
    assert (outcome.code, outcome.out) == (130, "") and outcome.err.startswith("stopped: 4 of 12 frames are kept")
    assert (read_run(tmp_path / "run").info["status"], len(read_run(tmp_path / "run").online)) == ("interrupted", 4)


def test_an_interrupt_while_a_library_is_loaded(drive, tmp_path, monkeypatch, fvslam):
    """Libraries in C++ make another exception of it."""

    def interrupted(self, sequence):
        raise ImportError("initialization failed") from KeyboardInterrupt()

    monkeypatch.setattr(pipeline, "through", interrupted)
    assert fvslam("run", drive, "--out", tmp_path / "run") == (130, "", "")


def test_frames_that_were_not_tracked_are_counted(drive, tmp_path, fvslam):
    recording = shutil.copytree(drive, tmp_path / "drive")
    for number in range(1, 12):
        (recording / "images" / f"{number:02d}.png").write_bytes(b"")
    code, out, err = fvslam("run", recording, "--out", tmp_path / "run")
    assert code == 0 and out.startswith("12 frames of drive: 1 static, 11 skipped; next: ") and out.count("\n") == 1
    assert err.startswith("drive: most frames were not tracked (1 static, 11 skipped)") and err.count("\n") == 1


def test_evaluate_files_with_a_reference(drive, tmp_path, fvslam):
    truth = drive / "groundtruth.tum"
    code, out, err = fvslam("evaluate", truth, "--reference", truth, "--align", "sim3")
    assert (code, err) == (0, "")
    assert "12 of 12 poses" in out and "sim3 (scale to the reference 1.0000)" in out


def test_info(drive, fvslam):
    code, out, err = fvslam("info", drive)
    assert (code, err) == (0, "")
    facts = dict(line.split(maxsplit=1) for line in out.splitlines())
    assert facts["format"].strip() == "folder"
    assert facts["frames"].startswith("12 in 1.1 s, 10.0 Hz")
    assert facts["images"].startswith("320x100 pixels")
    assert "12 poses" in out and "above ground (times.csv height_m)" in facts["scale"]
    assert "above ground (given)" in fvslam("info", drive, "--camera-height", 2).out


def test_a_calibration_by_a_recording(fvslam, tmp_path):
    """What it writes is read again, and says that the file is right."""
    calibrate = ("calibrate", "synthetic:uav?frames=60", "--out", tmp_path / "camera.yaml")
    code, out, err = fvslam(*calibrate)
    assert (code, err) == (0, "")
    k1, sigma = map(float, re.search(r"^k1 = (\S+) \+- (\S+)$", out, re.MULTILINE).groups())
    assert k1 == 0 < sigma < 0.01
    taken_out = (
        "run",
        "synthetic:uav?frames=3",
        "--recalibration",
        tmp_path / "camera.yaml",
        "--out",
        tmp_path / "run",
    )
    assert fvslam(*taken_out).code == 0
    assert "camera.yaml exists and is not overwritten" in fvslam(*calibrate).err
    assert "does not tell its calibration" in fvslam("calibrate", "synthetic:uav?frames=5", "--out", tmp_path / "x").err


def test_demo(tmp_path, fvslam, undrawn):
    code, out, err = fvslam("demo", "--frames", 10, "--out", tmp_path)
    assert (code, err) == (0, "")
    for name in ("vo-tuned", "vslam-tuned", "average-tuned", "intersection-tuned", "average-paper"):
        assert (tmp_path / name / "metrics.json").is_file()
        assert f" {name} " in out
    assert max(len(line) for line in out.splitlines() if str(tmp_path) not in line) <= 80
    assert out.splitlines()[-1] == f"plots: {tmp_path / 'plots'}"
    assert {file.stem for file in (tmp_path / "plots").glob("*.png")} == {f"plot_{name}" for name in FIGURES}


def test_a_progress_bar_on_a_terminal_only(drive, tmp_path, monkeypatch, fvslam):
    assert fvslam("run", drive, "--out", tmp_path / "run").err == ""
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes this for a terminal
    assert "100%" in fvslam("run", drive, "--out", tmp_path / "run").err


def test_commands_are_listed_in_the_order_of_their_use():
    assert " ".join(COMMANDS) == "run live evaluate plot export compare study table info calibrate demo data"


@pytest.mark.parametrize("command", [(), *((command,) for command in COMMANDS)])
def test_help(fvslam, command):
    code, out, err = fvslam(*command, "--help")
    assert (code, err) == (0, "")
    assert "Usage: fvslam" in out
    assert all(name in out for name in (COMMANDS if not command else ("--help",)))


@pytest.mark.parametrize("arguments", [["run"], ["run", "x", "--stride", "0"], ["run", "x", "--seed", "y"], ["fly"]])
def test_wrong_usage_exits_with_2(fvslam, arguments):
    code, out, err = fvslam(*arguments)
    assert (code, out) == (2, "") and "Usage: fvslam" in err


def test_help_imports_nothing_heavy():
    script = (
        "import sys\n"
        "from fvslam_graph.cli import app\n"
        f"for command in {[[], *([command] for command in COMMANDS)]}:\n"
        "    app([*command, '--help'], standalone_mode=False)\n"
        "print(*{name.partition('.')[0] for name in sys.modules}, file=sys.stderr)\n"
    )
    process = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    imported = set(process.stderr.split())
    assert "typer" in imported
    assert not imported & HEAVY


@pytest.mark.parametrize("option", ["--preset fast", "--scale feet", "--align se4"])
def test_a_choice_that_there_is_not(fvslam, tmp_path, monkeypatch, option):
    monkeypatch.chdir(tmp_path)
    command = "evaluate" if "--align" in option else "run"
    code, _, err = fvslam(command, "x", *option.split())
    assert code == 2 and option.split()[1] in err
    assert not list(tmp_path.iterdir())


def test_choices_and_completion_are_shown(fvslam, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    _, out, _ = fvslam("run", "--help")
    assert all(
        choices in out
        for choices in ("vo, vslam, average, intersection, graph, or a path", "paper|tuned", "plane|map|oracle")
    )
    assert "none|origin|se3|sim3" in fvslam("plot", "--help").out
    assert "--install-completion" in fvslam("--help").out


def test_version(fvslam):
    assert fvslam("--version") == (0, f"fvslam {fvslam_graph.__version__}\n", "")


def test_demo_says_which_extra_it_needs(fvslam, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "evo", None)
    code, _, err = fvslam("demo", "--out", tmp_path / "demo")
    assert (code, err) == (1, "fvslam: evo is not installed; `pip install fvslam-graph[eval]` brings it\n")
    assert not (tmp_path / "demo").exists()


def test_the_package_is_a_program(tmp_path):
    command = [sys.executable, "-m", "fvslam_graph", "info", str(tmp_path / "absent")]
    process = subprocess.run(command, capture_output=True, text=True)
    assert process.returncode == 1
    assert process.stderr == f"fvslam: {tmp_path / 'absent'} does not exist\n"


def test_the_config_of_a_run_repeats_it(drive, tmp_path, fvslam):
    chosen = ("--preset", "paper", "--mode", "average", "--seed", 3, "--set", "vo.min_inliers=30")
    assert fvslam("run", drive, "--out", tmp_path / "a", *chosen).code == 0
    assert fvslam("run", drive, "--out", tmp_path / "b", "--config", tmp_path / "a" / "config.yaml").code == 0
    config = yaml.safe_load((tmp_path / "b" / "config.yaml").read_text())
    assert (config["preset"], config["mode"], config["seed"], config["vo"]["min_inliers"]) == (
        "paper",
        "average",
        3,
        30,
    )
    for name in ("config.yaml", "trajectory_online.tum"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_visual_slam_and_a_look_at_its_landmarks(fvslam, tmp_path, monkeypatch):
    out = tmp_path / "run"
    assert fvslam("run", "synthetic:uav?frames=8&size=320x240", "--mode", "vslam", "--out", out).code == 0
    assert json.loads((out / "run.json").read_text())["mode"] == "vslam"
    assert fvslam("evaluate", out).code == 0
    monkeypatch.setattr(plots, "plot_runs", lambda *_: [])  # takes seconds, and is tested above
    outcome = fvslam("plot", out, "--landmarks", "5,7")
    assert outcome.code == 0
    for name in ("plot_landmarks_000005.png", "plot_landmarks_000007.png"):
        assert (out / name).stat().st_size > 20_000
        assert name in outcome.out


@pytest.fixture(scope="module")
def mapped(tmp_path_factory):
    """The folder of a run with landmarks."""
    folder = tmp_path_factory.mktemp("runs") / "mapped"
    command = ["run", "synthetic:uav?frames=6&size=320x240", "--mode", "vslam", "--out", str(folder)]
    app(command, standalone_mode=False)
    return folder


def test_landmarks_are_shown_of_the_nearest_frame_that_has_any(fvslam, mapped, tmp_path, monkeypatch):
    monkeypatch.setattr(plots, "plot_runs", lambda *_: [])
    assert fvslam("plot", mapped, "--landmarks", "0", "--out", tmp_path / "plots").code == 0
    (file,) = (tmp_path / "plots").glob("plot_landmarks_*.png")
    assert 1 <= int(file.stem[-6:]) <= 3


@pytest.mark.parametrize(
    ("landmarks", "complaint"),
    [("5;7", "--landmarks takes numbers of frames"), ("99", "has no frame 99"), ("-1", "has no frame -1")],
)
def test_landmarks_that_cannot_be_shown(fvslam, mapped, landmarks, complaint):
    outcome = fvslam("plot", mapped, "--landmarks", landmarks)
    assert outcome.code == 1
    assert complaint in outcome.err and "Traceback" not in outcome.err


def test_odometry_has_no_landmarks_to_show(fvslam, drive, tmp_path):
    out = tmp_path / "run"
    fvslam("run", drive, "--out", out)
    outcome = fvslam("plot", out, "--landmarks", "5")
    assert outcome.code == 1
    assert "run it with visual SLAM" in outcome.err


def test_an_unknown_mode(fvslam, drive, tmp_path):
    outcome = fvslam("run", drive, "--mode", "slam", "--out", tmp_path / "run")
    assert outcome.code == 1
    assert "'mode' cannot be 'slam'" in outcome.err and "none of vo, vslam" in outcome.err


def test_compare(fvslam, drive, tmp_path, undrawn):
    command = (
        "compare",
        drive,
        "--modes",
        "vo,average",
        "--seeds",
        1,
        "--set",
        "features.count=200",
        "--out",
        tmp_path,
    )
    outcome = fvslam(*command, "--external", f"other={drive / 'groundtruth.tum'}")
    assert outcome.code == 0
    assert re.fullmatch(r"1/2 vo on drive, seed 0: APE .* m\n2/2 average on drive, seed 0: APE .* m\n", outcome.err)
    assert all(word in outcome.out for word in (" vo ", " average ", " other ", "sim3 alignment", "too few recordings"))
    assert outcome.out.endswith(f"report: {tmp_path / 'report.html'}\n")
    begun = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("runs/*/frames.csv")}
    assert fvslam(*command).code == 0
    assert {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("runs/*/frames.csv")} == begun


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("--modes", "vo,fast"), "'modes.1' cannot be 'fast'"),
        (("--external", "orb.tum"), "--external takes NAME=FILE, not 'orb.tum'"),
        (("--set", "vo.inliers=3"), "there is no setting 'vo.inliers'; the nearest is 'vo.min_inliers'"),
        (("--set", "vo.inliers"), "--set takes group.name=value"),
    ],
)
def test_a_wrong_comparison_is_one_sentence(fvslam, drive, tmp_path, options, complaint):
    outcome = fvslam("compare", drive, "--out", tmp_path / "out", *options)
    assert (outcome.code, outcome.out) == (1, "")
    assert complaint in outcome.err and outcome.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_study(fvslam, drive, tmp_path, undrawn):
    file = tmp_path / "short.yaml"
    file.write_text(f"sequences: [{drive}, absent]\nmodes: [vo]\nseeds: 1\n")
    outcome = fvslam("study", file, "--out", tmp_path / "out")
    assert outcome.code == 0
    assert sorted(line.partition(":")[0] for line in outcome.err.splitlines()) == [
        *("1/2 vo on absent, seed 0", "2/2 vo on drive, seed 0"),
    ]
    assert "1/1" in outcome.out and "0/1" in outcome.out and "does not exist" in outcome.err
    assert len(list((tmp_path / "out" / "runs").iterdir())) == 1

    file.write_text("sequences: [absent]\nmodes: [vo]\nseeds: 1\n")
    outcome = fvslam("study", file, "--out", tmp_path / "out")
    assert outcome.code == 1 and outcome.err.endswith("fvslam: no run came to its end; the table says why\n")


def test_a_study_that_is_stopped_says_what_is_kept(fvslam, drive, tmp_path, monkeypatch):
    def interrupted(jobs, *_):
        raise KeyboardInterrupt

    monkeypatch.setattr("fvslam_graph.study.run.execute_all", interrupted)
    outcome = fvslam("compare", drive, "--modes", "vo", "--out", tmp_path / "out")
    kept = f"stopped: the runs that came to their end are kept in {tmp_path / 'out'}; "
    assert outcome == (130, "", f"{kept}the same command goes on from there\n")
