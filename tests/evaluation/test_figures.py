"""Figures as they are rendered: no text is cut or covered, and runs can be told apart in any colours."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fvslam_graph.core.trajectory import Status
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.plots.curve import common_unit, curve_of
from fvslam_graph.evaluation.plots.paths import magnification, magnified
from fvslam_graph.evaluation.plots.runs import FIGURES, plot_runs
from fvslam_graph.runs.results import Run
from fvslam_graph.runs.run_folder import read_run

from .conftest import MakeRun, drive

NAMES = ("vo-tuned", "vslam-tuned", "average-tuned", "intersection-tuned", "graph-tuned", "average-paper")
CLEAR = 0.08  # of the ink of a legend's handles; measured 0.11 at least


@pytest.fixture
def six(make_run: MakeRun) -> list[Run]:
    """Runs like those of the demo."""
    runs = [
        read_run(make_run(name, drive(120), n, 1 + 0.01 * n, sequence="synthetic:uav?frames=120&seed=12"))
        for n, name in enumerate(NAMES)
    ]
    status = runs[0].frames["status"].copy()
    status[20:24], status[40:44], status[60:64] = Status.STATIC, Status.SKIPPED, Status.REINITIALISED
    return [replace(runs[0], frames={**runs[0].frames, "status": status}), *runs[1:]]


def test_nothing_is_cut_or_covered_and_all_can_be_told_apart(six, tmp_path, drawn) -> None:
    plot_runs(six, tmp_path, Alignment.SIM3, suffixes=(".png",))
    assert len(drawn) == len(FIGURES)
    for figure in drawn:
        assert len(figure.texts) > 10
        assert (figure.clipped(), figure.overlapping()) == ([], [])
        if figure.figure.legends:
            assert min(figure.differences().values()) > CLEAR


def test_long_names_are_not_cut_either(six, tmp_path, drawn) -> None:
    runs = [
        replace(run, name=f"{n} {'n' * 300}", info={**run.info, "scale_source": "map"}) for n, run in enumerate(six)
    ]
    plot_runs(runs[:2], tmp_path, figures=("error", "covariance"), suffixes=(".png",))
    for figure in drawn:
        assert (figure.clipped(), figure.overlapping()) == ([], [])


def test_ten_runs_have_looks_of_their_own(six, tmp_path, drawn) -> None:
    runs = [replace(run, name=f"run {n}") for n, run in enumerate([*six, *six[:4]])]
    plot_runs(runs, tmp_path, figures=("error",), suffixes=(".png",))
    assert min(drawn[0].differences().values()) > CLEAR


def test_text_stays_text(six, tmp_path) -> None:
    pdf, svg = plot_runs(six[:1], tmp_path, figures=("error",), suffixes=(".pdf", ".svg"))
    assert b"/CIDFontType2" in pdf.read_bytes() and b"/Type3" not in pdf.read_bytes()
    assert ">travelled distance of the ground truth (m)</text>" in svg.read_text()


def test_paths_that_coincide_are_magnified(make_run: MakeRun) -> None:
    def curves(gain: float):
        run = read_run(make_run(f"gain {gain}", drive(120), gain=gain))
        assert run.ground_truth is not None
        return [curve_of(run, Alignment.SE3, 0, np.eye(3), np.eye(4))]

    assert magnification(curves(1.5)) is None
    (near,) = curves(1.002)
    factor = magnification([near])
    assert factor is not None and factor >= 10
    assert near.reference is not None
    shift = magnified(near.estimate.positions, near.reference, factor) - near.reference
    assert np.allclose(shift, factor * (near.estimate.positions - near.reference), atol=1e-9)
    extent = np.ptp(near.reference, axis=0).max()
    assert 0.05 * extent < np.abs(shift).max() < 0.2 * extent


def test_units_where_the_scale_is_relative(make_run: MakeRun, tmp_path: Path) -> None:
    folder = make_run("free", drive(30), ground_truth=False, scale_source="map")
    blind = read_run(folder)
    known = read_run(make_run("known", drive(30), gain=0.5, scale_source="map"))
    axes = (np.eye(3), np.eye(4))
    assert common_unit([curve_of(blind, Alignment.SE3, 0, *axes)]) == "own unit"
    curve = curve_of(known, Alignment.SE3, 0, *axes)
    assert (common_unit([curve]), curve.unit, curve.name) == ("m", "own unit", "known, relative scale")
    curve = curve_of(known, Alignment.SIM3, 0, *axes)
    assert (curve.unit, curve.name) == ("m", "known")
    assert curve.scale == pytest.approx(2, rel=0.02)
    (file,) = plot_runs([blind], tmp_path, figures=("trajectory",), suffixes=(".svg",))
    assert "(own unit)" in file.read_text() and "(m)" not in file.read_text()
