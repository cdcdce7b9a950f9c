"""What several tests share."""

import functools
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import pytest
from threadpoolctl import threadpool_limits

from fvslam_graph.cli import main
from fvslam_graph.simulation import synthetic
from fvslam_graph.simulation.synthetic import synthetic_sequence

pytest_plugins = ["fvslam_graph.testing"]

ROOT = Path(__file__).parents[1]

if "PYTEST_XDIST_WORKER" in os.environ:  # there are as many of these as cores
    cv2.setNumThreads(1)
    threadpool_limits(1)


build = synthetic._build


@functools.lru_cache(6)
def built_once(options: object) -> object:
    """A synthetic world that keeps what it renders: many tests look at the same few frames."""
    world = build(options)
    world.render = functools.lru_cache(48)(world.render)
    return world


synthetic._build = functools.update_wrapper(built_once, build)


@pytest.fixture(scope="session")
def real_data() -> Callable[[str], Path]:
    """The folder of a real recording, by its name below FVSLAM_DATA; skips the test where it is absent."""

    def find(name: str) -> Path:
        path = Path(os.environ.get("FVSLAM_DATA", ROOT.parent / "shared" / "data")) / name
        if not path.exists():
            pytest.skip(f"real sequence {name} is not at {path}; set FVSLAM_DATA to its folder")
        return path

    return find


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plain folder to read or copy: 12 rendered images of a road between facades, with heights and ground truth."""
    folder = tmp_path_factory.mktemp("recordings") / "drive"
    (folder / "images").mkdir(parents=True)
    sequence = synthetic_sequence("drive", frames=12, size="320x100")
    times = ["filename,timestamp_s,height_m"]
    for frame in sequence:
        name = f"{frame.index:02d}.png"
        assert cv2.imwrite(str(folder / "images" / name), frame.image)
        times.append(f"{name},{frame.stamp:.3f},{frame.height:.3f}")
    (folder / "times.csv").write_text("\n".join(times) + "\n")
    camera = sequence.camera
    (folder / "camera.yaml").write_text(
        f"image_width: {camera.width}\nimage_height: {camera.height}\ncamera_matrix: {camera.K.ravel().tolist()}\n"
    )
    sequence.ground_truth.write_tum(folder / "groundtruth.tum")
    return folder


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures become files with nothing to see: for tests of what is around them, since drawing takes seconds."""
    from matplotlib.figure import Figure

    monkeypatch.setattr(Figure, "draw_without_rendering", lambda figure: None)
    monkeypatch.setattr(Figure, "savefig", lambda figure, file, **options: file.write(b"not drawn"))


class Ended(NamedTuple):
    """How a command ended, and what it printed."""

    code: int
    out: str
    err: str


@pytest.fixture
def fvslam(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Runs the command line within this process; what it prints includes that of libraries in C++."""

    def run(*arguments: object) -> Ended:
        monkeypatch.setattr(sys, "argv", ["fvslam", *map(str, arguments)])
        with pytest.raises(SystemExit) as exit:
            main()
        return Ended(exit.value.code or 0, *capfd.readouterr())

    return run
