"""The Python of the README runs as it stands, on recordings that are smaller."""

import re
import textwrap
from pathlib import Path

import cv2
import pytest

import fvslam_graph
from fvslam_graph.sequences.open import open_sequence

README = Path(__file__).parents[1] / "README.md"
BLOCKS = re.findall(r"(?:^ {4}.*\n|^\n)+", README.read_text(), re.MULTILINE)
SNIPPETS = [textwrap.dedent(block) for block in BLOCKS if "import fvslam_graph" in block]


@pytest.fixture
def kitti(drive, tmp_path):
    """The short drive as a sequence of KITTI's odometry benchmark."""
    sequence, folder = open_sequence(drive), tmp_path / "kitti" / "sequences" / "03"
    (folder / "image_0").mkdir(parents=True)
    for frame in sequence:
        assert cv2.imwrite(str(folder / "image_0" / f"{frame.index:06d}.png"), frame.image)
    camera = sequence.camera
    P0 = f"P0: {camera.fx} 0 {camera.cx} 0 0 {camera.fy} {camera.cy} 0 0 0 1 0\n"
    (folder / "calib.txt").write_text(P0)
    (folder / "times.txt").write_text("".join(f"{stamp:e}\n" for stamp in sequence.stamps))
    (folder.parents[1] / "poses").mkdir()
    sequence.ground_truth.write_kitti(folder.parents[1] / "poses" / "03.txt")
    return folder


@pytest.mark.parametrize("snippet", SNIPPETS)
def test_it_runs(snippet, kitti, tmp_path, monkeypatch, undrawn):
    monkeypatch.chdir(tmp_path)
    for large, small in (
        ("/data/kitti/sequences/03", str(kitti)),
        ("synthetic:uav", "synthetic:uav?frames=12&size=320x240"),
        ("seeds=5", "seeds=1"),
    ):
        assert large in snippet
        snippet = snippet.replace(large, small)
    names: dict = {}
    exec(snippet, names)
    assert names["evaluation"].errors["ape_trans"].stats["rmse"] < 1
    assert set(names["results"].finished["mode"]) == {"vo", "graph"}


def test_there_is_some():
    assert len(SNIPPETS) == 1


def test_what_can_be_asked_for_is_listed():
    assert {"run", "evaluate", "compare", "testing", "__version__"} <= set(dir(fvslam_graph))
    assert all(hasattr(fvslam_graph, name) for name in fvslam_graph.__all__)
