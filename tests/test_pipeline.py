"""The loop over the frames, on a short drive."""

from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.config import ScaleSource, load_config
from fvslam_graph.errors import ConfigError
from fvslam_graph.pipeline import STAGES, applicable, estimate, facts
from fvslam_graph.sequences.opening import open_sequence
from fvslam_graph.trajectory import Status


@pytest.fixture
def sequence(drive):
    return open_sequence(drive)


def test_one_result_a_frame(sequence):
    results = list(estimate(sequence, load_config()))
    assert [result.index for result in results] == list(range(12))
    assert [result.stamp for result in results] == pytest.approx(sequence.stamps.tolist())
    assert results[0].pose.equals(type(results[0].pose)(), 0)
    assert results[0].previous == 0
    for result in results[1:]:
        assert result.previous < result.index
        assert result.pose.equals(results[result.previous].pose * result.relative, 1e-9)
        assert np.allclose(result.covariance, result.covariance.T)
        assert np.linalg.eigvalsh(result.covariance)[0] > -1e-12
    assert {tuple(result.measures) for result in results} == {tuple(results[0].measures)}
    assert {tuple(result.times) for result in results} == {STAGES}


def test_frames_are_read_when_they_are_asked_for(sequence):
    read = []

    def load(index):
        read.append(index)
        return sequence.load(index)

    results = estimate(replace(sequence, load=load), load_config())
    next(results)
    next(results)
    assert read == [0, 1]


@pytest.mark.parametrize("source", ["plane", "oracle"])
def test_metric_scale(sequence, source):
    results = list(estimate(sequence, load_config(settings=[f"scale.source={source}"])))
    travelled = np.linalg.norm(results[-1].pose.translation())
    true = np.linalg.norm(sequence.ground_truth.positions[-1] - sequence.ground_truth.positions[0])
    assert travelled == pytest.approx(true, rel={"plane": 0.2, "oracle": 0.02}[source])
    assert travelled != pytest.approx(true, rel=1e-9)


def test_unit_scale(sequence):
    results = list(estimate(sequence, load_config(settings=["scale.source=unit"])))
    lengths = [np.linalg.norm(result.relative.translation()) for result in results if result.measures["scale"] > 0]
    assert len(lengths) > 5 and np.allclose(lengths, 1)


def test_frames_without_image_are_skipped(sequence):
    lost = replace(sequence, load=lambda index: None if index in (0, 5) else sequence.load(index))
    results = list(estimate(lost, load_config()))
    assert [result.index for result in results if result.status is Status.SKIPPED] == [0, 5]
    assert len(results) == 12


def test_the_scale_is_relative_where_no_ground_is_known(sequence):
    config = load_config()
    assert applicable(config, sequence) is config
    unknown = replace(sequence.ground, heights=np.full(12, np.nan))
    for ground in (None, unknown):
        relative = applicable(config, replace(sequence, ground=ground))
        assert relative.scale.source is ScaleSource.MAP
        assert relative == load_config(settings=["scale.source=map"])


def test_the_oracle_needs_ground_truth(sequence):
    config = load_config(settings=["scale.source=oracle"])
    assert applicable(config, sequence) is config
    with pytest.raises(ConfigError, match="drive has no ground truth for the scale source 'oracle'"):
        applicable(config, replace(sequence, ground_truth=None))


def test_facts(sequence):
    config = load_config(settings=["seed=3"])
    known = facts(sequence, config)
    assert (known["mode"], known["sequence"], known["format"], known["frames"]) == ("vo", "drive", "folder", 12)
    assert (known["scale_source"], known["seed"]) == ("plane", 3)
    assert known["down"].tolist() == [0, 1, 0]
    assert facts(replace(sequence, ground=None), config)["down"] is None
