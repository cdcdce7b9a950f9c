"""What other packages add: by entry point or path, without a fork."""

import json
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from fvslam_graph.core import plugins
from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import ConfigError, SequenceError
from fvslam_graph.sequences.open import open_sequence

SHORT = "synthetic:uav?frames=12&size=160x120"
MODULE = """
import gtsam, numpy as np
from fvslam_graph.core.frame_result import FrameResult
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.trajectory import Status
from fvslam_graph.features.klt import KltTracker
from fvslam_graph.sequences import folder

class Marked:
    FORMAT, LAYOUT = "marked", "mark.txt and a plain folder"
    def matches(self, path):
        return (path / "mark.txt").is_file()
    def read(self, path):
        return folder.read(path)

class OdometryAlone:
    def __call__(self, odometry, slam):
        return odometry

class Still:
    def __init__(self, camera, ground, seed):
        self.frames, self.pose = 0, GaussianPose(gtsam.Pose3(), np.eye(6))
    def step(self, image, stamp, height):
        self.frames += 1
        return FrameResult(self.frames - 1, stamp, self.pose, Status.STATIC, max(self.frames - 2, 0), self.pose)
    def finish(self):
        return None

class Fewer(KltTracker):
    pass
"""
ENTRY_POINTS = """
[fvslam_graph.formats]
marked = fvslam_other:Marked
[fvslam_graph.fusion_rules]
odometry-alone = fvslam_other:OdometryAlone
[fvslam_graph.estimators]
still = fvslam_other:Still
[fvslam_graph.trackers]
fewer = fvslam_other:Fewer
"""


def install(folder: Path, entry_points: str = ENTRY_POINTS, version: str = "0.3") -> Path:
    """A package in a folder, as pip leaves it there."""
    (folder / "fvslam_other.py").write_text(MODULE)
    info = folder / f"fvslam_other-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: fvslam-other\nVersion: {version}\n")
    (info / "entry_points.txt").write_text(entry_points)
    return folder


def forget():
    for cached in (plugins._entries, plugins._loaded, plugins.source_hash):
        cached.cache_clear()


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Another package beside ours, for this process and those that it starts."""

    def make(*arguments):
        site = tmp_path / "site"
        site.mkdir()
        monkeypatch.syspath_prepend(install(site, *arguments))
        monkeypatch.setenv("PYTHONPATH", str(site))
        forget()
        return site

    yield make
    sys.modules.pop("fvslam_other", None)
    forget()


def test_a_package_beside_ours(installed, drive, tmp_path, fvslam):
    """Listed by help, run, in a study on two workers, in its report; its version is part of a run."""
    installed()
    for command in ("run", "compare"):
        said = " ".join(fvslam(command, "--help").out.split())
        for name in ("format marked", "fusion rule odometry-alone", "tracker fewer", "estimator still"):
            assert f"{name} (fvslam-other 0.3)" in said

    recording = tmp_path / "marked"
    recording.mkdir()
    for path in drive.iterdir():
        (recording / path.name).symlink_to(path)
    (recording / "mark.txt").touch()
    options = ("--mode", "odometry-alone", "--set", "features.association=fewer", "--out", tmp_path / "run")
    assert fvslam("run", recording, *options).code == 0
    info = json.loads((tmp_path / "run" / "run.json").read_text())
    assert (info["mode"], info["format"]) == ("odometry-alone", "marked")
    assert [(one["name"], one["version"]) for one in info["plugins"]] == [
        ("odometry-alone", "0.3"),
        ("fewer", "0.3"),
        ("marked", "0.3"),
    ]

    modes = "vo,still,odometry-alone,fvslam_other:Still"
    (tmp_path / "grid.yaml").write_text(f"sequences: ['{SHORT}', marked]\nmodes: [{modes}]\nseeds: 1\n")
    command = [sys.executable, "-m", "fvslam_graph", "study", "grid.yaml", "--out", "out", "--workers", "2"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    table = pd.read_csv(tmp_path / "out" / "results.csv")
    assert table["mode"].tolist() == 2 * modes.split(",") and set(table["status"]) == {"finished"}
    report = (tmp_path / "out" / "report.html").read_text()
    assert "odometry-alone" in report and "still" in report


def test_the_version_is_part_of_the_hash(installed, tmp_path):
    from fvslam_graph.study.jobs import Job
    from fvslam_graph.study.sources import Source

    site = installed()
    job = Job(Source(path=SHORT), load_config(settings=["mode=still"]))
    before = job.folder(tmp_path)
    assert before == job.folder(tmp_path)
    (site / "fvslam_other.py").write_text(MODULE + "# changed\n")
    forget()
    changed = job.folder(tmp_path)
    (site / "fvslam_other-0.3.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: fvslam-other\nVersion: 0.4\n"
    )
    forget()
    assert len({before, changed, job.folder(tmp_path)}) == 3


@pytest.mark.parametrize(
    ("mode", "said"),
    [
        (
            "absent_package:Rule",
            "the estimator or fusion rule 'absent_package:Rule' cannot be imported: No module named",
        ),
        ("fvslam_other:Nothing", "has no attribute 'Nothing'; is its package installed, or on PYTHONPATH?"),
        ("fvslam_other: Still", "'mode' cannot be"),
        (
            "fvslam_other:Marked",
            "is no estimator or fusion rule: an estimator has step(image, stamp, height) and finish()",
        ),
        ("fvslam_other:np", "is no estimator or fusion rule"),
        ("fvslam_other:a b", "has to be written as package.module:Name"),
        ("fly", "it is none of vo, vslam, average, intersection, graph"),
    ],
)
def test_what_is_no_mode(installed, mode, said):
    installed()
    with pytest.raises(ConfigError) as error:
        load_config(settings=[f"mode={mode}"])
    assert said in str(error.value) and "\n" not in str(error.value)


def test_what_does_not_fit(installed):
    site = installed()
    with (site / "fvslam_other.py").open("a") as file:
        file.write("class Short(Still):\n    def step(self, image):\n        pass\n")
        file.write("class Unmade(OdometryAlone):\n    def __init__(self, weight):\n        pass\n")
        file.write("def alone(sequence):\n    pass\n")
        file.write("made = Still(None, None, 0)\n")
    for name, said in (
        ("Short", "its step does not take (image, stamp, height)"),
        ("Unmade", "its class has to be made with ()"),
        ("alone", "such a function is called with (sequence, seed)"),
        ("made", "it is an object already; name its class"),
    ):
        with pytest.raises(ConfigError, match=f"fvslam_other:{name} is no ") as error:
            load_config(settings=[f"mode=fvslam_other:{name}"])
        assert said in str(error.value)
    with pytest.raises(ConfigError, match="fvslam_other:Still is no tracker"):
        load_config(settings=["features.association=fvslam_other:Still"])


def test_a_name_that_two_have(installed):
    installed(ENTRY_POINTS.replace("still =", "vo =") + "[fvslam_graph.formats]\nfolder = fvslam_other:Marked\n")
    with pytest.raises(ConfigError, match=r"fvslam-other 0\.3 has an estimator called 'vo', but one of ours"):
        load_config(settings=["mode=vo"])


def test_a_format_by_its_path(installed, drive):
    installed()
    with pytest.raises(SequenceError, match=r"looked for mark\.txt and a plain folder \(fvslam_other:Marked\)"):
        open_sequence(drive, format="fvslam_other:Marked")
    with pytest.raises(SequenceError, match="the format 'kitty' is not one of marked, kitti-odometry"):
        open_sequence(drive, format="kitty")
