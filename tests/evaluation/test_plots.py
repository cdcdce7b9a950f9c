from pathlib import Path

import cv2
import numpy as np
import pytest

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.evaluation.plots.runs import FIGURES, level_axes, plot_runs
from fvslam_graph.runs.run_folder import read_run

from .conftest import MakeRun, drive


def coloured(path: Path, colour: str) -> int:
    """Number of pixels of a figure near a colour given as #RRGGBB."""
    bgr = np.array([int(colour[i : i + 2], 16) for i in (5, 3, 1)])
    image = cv2.imread(str(path))
    assert image is not None
    return int((np.abs(image.astype(int) - bgr).max(axis=2) < 20).sum())


def test_figures_of_two_runs_hold_both(make_run: MakeRun, tmp_path: Path) -> None:
    folders = [make_run("first", truth=drive(80), gain=1.1), make_run("second", truth=drive(80), gain=0.9, seed=1)]
    files = plot_runs([read_run(folder) for folder in folders], tmp_path / "out")
    assert sorted(path.name for path in files) == sorted(f"plot_{n}{s}" for n in FIGURES for s in (".png", ".pdf"))
    for path in files:
        if path.suffix == ".pdf":
            assert path.read_bytes().startswith(b"%PDF")
        else:
            assert coloured(path, "#0072B2") > 200
            assert coloured(path, "#D55E00") > 200


def test_a_run_without_ground_truth_is_drawn_without_error(make_run: MakeRun) -> None:
    folder = make_run(truth=drive(20), ground_truth=False, down=None)
    files = plot_runs([read_run(folder)], folder, suffixes=(".png",))
    assert {path.stem for path in files} == {"plot_trajectory", "plot_speed", "plot_features"}
    assert all(path.stat().st_size > 5000 for path in files)


def test_what_cannot_be_plotted_is_one_sentence(make_run: MakeRun, tmp_path: Path) -> None:
    one, other = make_run("one", truth=drive(20)), make_run("other", truth=drive(20), sequence="walk")
    with pytest.raises(ResultsError, match="different sequences, drive, walk"):
        plot_runs([read_run(one), read_run(other)], tmp_path)
    with pytest.raises(ResultsError, match="too few poses to plot, 1;"):
        plot_runs([read_run(make_run("short", truth=drive(1)))], tmp_path)
    with pytest.raises(ResultsError, match="cannot be written"):
        plot_runs([read_run(one)], one / "run.json")


@pytest.mark.parametrize(
    ("down", "forward"),
    [((0, 1, 0), (0, 0, 1)), ((0, 0, 1), (0, -1, 0)), ((0, np.sin(1.0), np.cos(1.0)), (0, -np.cos(1.0), np.sin(1.0)))],
)
def test_level_axes_of_a_forward_a_downward_and_an_oblique_camera(down, forward) -> None:
    axes = level_axes(np.array(down, dtype=float))
    assert np.allclose(axes, [[1, 0, 0], forward, np.negative(down)], atol=1e-12)
