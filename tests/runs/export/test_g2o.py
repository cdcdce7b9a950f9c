"""Pose graphs, read back by GTSAM."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

import fvslam_graph
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.core.frame_result import G2O


def read(path):
    graph, values = gtsam.readG2o(str(path), True)
    edges = [graph.at(n) for n in range(graph.size())]
    return [edge for edge in edges if isinstance(edge, gtsam.BetweenFactorPose3)], values


def test_a_chain_of_relative_motions(run, tmp_path):
    done = fvslam_graph.export(run, "g2o", tmp_path / "flight.g2o")
    assert "from frame to frame" in done.notes[0]
    edges, values = read(done.path)
    assert all(values.atPose3(n).equals(pose, 1e-9) for n, pose in enumerate(run.online.poses))
    assert [tuple(edge.keys()) for edge in edges] == [(n, n + 1) for n in range(7)]
    for edge, matrix, covariance in zip(
        edges, run.relatives.prev_T_cur[1:], run.relatives.covariances[1:], strict=True
    ):
        assert edge.measured().equals(gtsam.Pose3(matrix), 1e-9)
        assert edge.error(values) == pytest.approx(0, abs=1e-9)
        assert np.allclose(edge.noiseModel().information() @ covariance, np.eye(6), rtol=0, atol=1e-6)


def test_what_is_exact_gets_a_deviation(run, tmp_path):
    covariances = run.relatives.covariances.copy()
    covariances[1] = np.diag([0.01, 0.02, 0.03, 0, 0, 0])
    covariances[2] = np.nan
    relatives = replace(run.relatives, covariances=covariances)
    edges, _ = read(fvslam_graph.export(replace(run, relatives=relatives), "g2o", tmp_path / "flight.g2o").path)
    assert [tuple(edge.keys()) for edge in edges] == [(n, n + 1) for n in range(7) if n != 1]
    assert np.allclose(np.diag(edges[0].noiseModel().information()), [100, 50, 100 / 3, 1e12, 1e12, 1e12])


def test_the_motions_of_the_factor_graph(graph_run, tmp_path):
    done = fvslam_graph.export(graph_run, "g2o", tmp_path / "smoothed.g2o", smoothed=True)
    edges, values = read(done.path)
    written, _ = read(graph_run.folder / G2O)
    assert "factor graph" in done.notes[0] and len(edges) == len(written)
    assert all(a.equals(b, 0) for a, b in zip(edges, written, strict=True))
    assert all(values.atPose3(n).equals(pose, 1e-9) for n, pose in enumerate(graph_run.smoothed.poses))


def test_a_run_that_did_not_end_has_no_motions(run, tmp_path):
    with pytest.raises(FvslamError, match="has no relative motions"):
        fvslam_graph.export(replace(run, relatives=None), "g2o", tmp_path / "flight.g2o")
