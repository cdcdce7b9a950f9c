"""The package from Python."""

import numpy as np
import pytest

import fvslam_graph
from fvslam_graph.errors import ConfigError, FvslamError
from fvslam_graph.evaluation.plots import FIGURES, plot_runs
from fvslam_graph.sequences.opening import open_sequence

SHORT = "synthetic:uav?frames=12&size=320x240"


def test_a_run_in_memory_is_the_run_in_a_folder(tmp_path, undrawn):
    options = {"mode": "graph", "settings": {"slam.min_landmarks": 30, "scale.source": "oracle"}, "seed": 2}
    memory = fvslam_graph.run(SHORT, **options)
    folder = fvslam_graph.run(open_sequence(SHORT), **options, out=tmp_path / "run")
    assert (memory.folder, folder.folder) == (None, tmp_path / "run")
    assert np.array_equal(memory.smoothed.stamps, folder.smoothed.stamps)
    for a, b in ((memory.online, folder.online), (memory.smoothed, folder.smoothed)):
        assert np.allclose(a.matrices, b.matrices, atol=1e-12)
    assert np.array_equal(memory.relatives.covariances, folder.relatives.covariances, equal_nan=True)
    assert list(memory.frames) == list(folder.frames)
    assert memory.frames["status"].tolist() == folder.frames["status"].tolist()
    assert np.allclose(memory.frames["scale"], folder.frames["scale"], equal_nan=True)
    assert memory.config == folder.config
    assert all(folder.info[key] == value for key, value in memory.info.items() if key != "down")
    assert len(plot_runs([memory], tmp_path / "plots")) == 2 * len(FIGURES)


def test_everything_that_can_be_evaluated(tmp_path):
    run = fvslam_graph.run(SHORT, out=tmp_path / "run")
    run.ground_truth.write_tum(tmp_path / "truth.tum")
    first = fvslam_graph.evaluate(run, align="sim3")
    error = first.errors["ape_trans"].stats["rmse"]
    assert 0 < error < 0.1 and first.consistency is not None
    for estimated in (run, run.online, tmp_path / "run", str(tmp_path / "run" / "trajectory_online.tum")):
        for reference in (run.ground_truth, tmp_path / "truth.tum"):
            again = fvslam_graph.evaluate(estimated, reference, "sim3")
            assert again.errors["ape_trans"].stats["rmse"] == pytest.approx(error, rel=1e-9)


def test_what_cannot_be_run_or_evaluated():
    with pytest.raises(ConfigError, match="'mode' cannot be 'slam'"):
        fvslam_graph.run(SHORT, mode="slam")
    run = fvslam_graph.run(SHORT)
    with pytest.raises(FvslamError, match="needs a reference"):
        fvslam_graph.evaluate(run.online)
    with pytest.raises(AttributeError, match="has no attribute 'fly'"):
        fvslam_graph.fly  # noqa: B018


def test_compare(tmp_path, undrawn):
    outcome = fvslam_graph.compare(SHORT, ["vo"], [3], settings={"features.count": [200, 300]}, out=tmp_path)
    assert outcome.table["variant"].tolist() == ["features.count=200", "features.count=300"]
    assert outcome.table["seed"].tolist() == [3, 3] and outcome.table["ape"].nunique() == 2
    assert (tmp_path / "report.html").is_file()
