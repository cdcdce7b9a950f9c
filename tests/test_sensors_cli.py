"""What other sensors than the camera have measured, on the command line."""

import json

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.geodesy import LocalFrame
from fvslam_graph.runs.run_folder import read_run
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.simulation.gnss import PLACE, true_enu

COLUMNS = ["east", "north", "up", "east_sigma", "north_sigma", "up_sigma"]


def test_a_run_with_fixes_knows_its_place_on_earth(drive, tmp_path, fvslam):
    truth = open_sequence(drive).ground_truth
    places = LocalFrame(PLACE).geodetic(true_enu(truth))
    rows = [f"{s:.6f},{a:.10f},{b:.10f},{c:.5f},0.05" for s, (a, b, c) in zip(truth.stamps, places, strict=True)]
    (tmp_path / "fixes.csv").write_text("\n".join(["stamp,latitude,longitude,altitude,sigma", *rows]) + "\n")
    folder = tmp_path / "run"
    code, _, err = fvslam("run", drive, "--mode", "graph", "--gnss", tmp_path / "fixes.csv", "--out", folder)
    assert (code, err) == (0, "")
    run = read_run(folder)
    assert run.info["gnss"] == "fixes.csv"
    last = [run.frames[name][-1] for name in COLUMNS]
    assert np.linalg.norm(last[:3] - LocalFrame(places[0]).enu(places[-1:])[0]) < 0.5  # measured: 0.05 m
    assert max(last[3], last[5]) < 0.1 and last[4] < 0.5  # at 12 m/s along a line, by a clock that is known to 0.03 s
    clock = run.info["placement"]["clock"]
    assert abs(clock["offset"]) < 0.05 and 0 < clock["sigma"] < 0.04
    assert np.isnan(run.frames["east"][0])

    code, _, err = fvslam("export", folder, "--to", "geojson", "--smoothed", "--out", tmp_path / "map.geojson")
    assert code == 0 and "factor graph" in err
    line = json.loads((tmp_path / "map.geojson").read_text())["features"][0]["geometry"]["coordinates"]
    there = LocalFrame(places[0]).enu(np.array(line)[:, [1, 0, 2]]) - LocalFrame(places[0]).enu(places)
    assert np.linalg.norm(there, axis=1).max() < 0.5


def test_fixes_that_tell_nothing_are_not_passed_over(drive, tmp_path, fvslam):
    given = ("--mode", "graph", "--gnss", "oxts:10:50", "--out", tmp_path / "run")  # on a path of 13 m
    code, _, err = fvslam("run", drive, *given)
    assert code == 0 and "do not tell where on Earth it is" in err
    run = read_run(tmp_path / "run")
    assert np.isnan(run.frames["east"]).all() and run.smoothed is not None


def test_without_fixes_nothing_is_said_of_earth(drive, tmp_path, fvslam):
    assert fvslam("run", drive, "--out", tmp_path / "run", "--frames", "0:3").code == 0
    run = read_run(tmp_path / "run")
    assert not set(COLUMNS) & set(run.frames) and "placement" not in run.info


def test_an_altimeter_of_another_rate_gives_the_scale(drive, tmp_path, fvslam):
    rows = "".join(f"{stamp:.3f},3.3\n" for stamp in np.arange(-0.5, 2, 0.13))
    (tmp_path / "altimeter.csv").write_text("stamp,height\n" + rows)
    given = (("--altimeter", tmp_path / "altimeter.csv"), ("--camera-height", 3.3), ("--ground-plane", "0 1 0 3.3"))
    lengths = []
    for number, options in enumerate(given):
        assert fvslam("run", drive, "--out", tmp_path / str(number), *options).code == 0
        lengths.append(np.linalg.norm(read_run(tmp_path / str(number)).online.positions[-1]))
    assert lengths == pytest.approx([lengths[0]] * 3, rel=0.02)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("--mode", "vo", "--gnss", "oxts:10:0.1"), "mode graph alone"),
        (("--mode", "graph", "--set", "scale.source=map", "--gnss", "oxts:10:0.1"), "in metres"),
        (("--mode", "graph", "--gnss", "recording"), "no fixes of a GNSS receiver"),
        (("--mode", "graph", "--gnss", "nowhere.csv"), "nowhere.csv is missing"),
        (("--mode", "graph", "--gnss", "oxts:10"), "RATE_HZ:SIGMA_M"),
        (("--mode", "graph", "--gnss", "oxts:10:0.1", "--gnss-sigma", 0), "positive number of metres"),
        (("--gnss-sigma", 2), "give both"),
        (("--altimeter", "nowhere.csv"), "nowhere.csv is missing"),
        (("--ground-plane", "down"), "four numbers"),
    ],
)
def test_what_cannot_be_used_is_one_sentence(drive, tmp_path, fvslam, options, complaint):
    code, _, err = fvslam("run", drive, "--out", tmp_path / "run", *options)
    assert code == 1 and complaint in err and len(err.splitlines()) == 1
    assert not (tmp_path / "run").exists()


def test_a_run_begins_where_it_is_said_to(drive, tmp_path, fvslam):
    """Poses are in that world, online and smoothed; covariances, which are the camera's own, stay as they are."""
    runs = []
    for number, options in enumerate(((), ("--start-pose", "10 20 30 0 0.6 0 0.8"))):
        given = ("--mode", "graph", "--gnss", "oxts:10:0.05", "--out", tmp_path / str(number))
        assert fvslam("run", drive, *given, *options).code == 0
        runs.append(read_run(tmp_path / str(number)))
    first, moved = runs
    start = gtsam.Pose3(gtsam.Rot3.Quaternion(0.8, 0, 0.6, 0), np.array([10.0, 20.0, 30.0]))
    for name in ("online", "smoothed"):
        expected = start.matrix() @ getattr(first, name).matrices
        assert np.allclose(getattr(moved, name).matrices, expected, rtol=0, atol=1e-9)
    assert np.array_equal(moved.pose_covariances, first.pose_covariances)
    assert np.allclose(moved.info["down"], start.rotation().rotate(np.array(first.info["down"])))
    there = np.array([run.info["placement"]["enu_T_world"] for run in runs])
    assert np.allclose(there[1] @ start.matrix(), there[0])


@pytest.mark.parametrize("start", ["1 2 3", "a b c d e f g", "0 0 0 0 0 0 2", "0 0 nan 0 0 0 1", ""])
def test_a_start_that_is_none(drive, tmp_path, fvslam, start):
    code, _, err = fvslam("run", drive, "--start-pose", start, "--out", tmp_path / "run")
    assert code == 1 and "tx ty tz qx qy qz qw" in err
    assert not (tmp_path / "run").exists()
