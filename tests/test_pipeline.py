"""What settings and a sequence make of a run."""

from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.core.choices import ScaleSource
from fvslam_graph.core.config import load_config
from fvslam_graph.core.errors import ConfigError
from fvslam_graph.pipeline import resolve_config, run_metadata
from fvslam_graph.sequences.open import open_sequence


@pytest.fixture
def sequence(drive):
    return open_sequence(drive)


def test_the_scale_is_relative_where_no_ground_is_known(sequence):
    config = load_config()
    assert resolve_config(config, sequence) is config
    unknown = replace(sequence.ground, heights=np.full(12, np.nan))
    for ground in (None, unknown):
        relative = resolve_config(config, replace(sequence, ground=ground))
        assert relative.scale.source is ScaleSource.MAP
        assert relative == load_config(settings=["scale.source=map"])


def test_the_oracle_needs_ground_truth(sequence):
    config = load_config(settings=["scale.source=oracle"])
    assert resolve_config(config, sequence) is config
    with pytest.raises(ConfigError, match="drive has no ground truth for the scale source 'oracle'"):
        resolve_config(config, replace(sequence, ground_truth=None))


def test_run_metadata(sequence):
    config = load_config(settings=["seed=3"])
    known = run_metadata(sequence, config)
    assert (known["mode"], known["sequence"], known["format"], known["frames"]) == ("vo", "drive", "folder", 12)
    assert (known["scale_source"], known["seed"]) == ("plane", 3)
    assert known["down"].tolist() == [0, 1, 0]
    assert run_metadata(replace(sequence, ground=None), config)["down"] is None
