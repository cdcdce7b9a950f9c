"""The median is numpy's."""

import numpy as np
import pytest

from fvslam_graph.core.quick import median


@pytest.mark.parametrize("count", [1, 2, 3, 8, 101])
def test_median(count):
    for seed in range(5):
        values = np.random.default_rng(seed).standard_normal(count).round(1)
        assert median(values) == np.median(values)
