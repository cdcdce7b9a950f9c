"""A mode depends on the settings that it is said to read, and on no others."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from fvslam_graph.core.choices import Mode
from fvslam_graph.core.config import load_config
from fvslam_graph.core.modes import reads
from fvslam_graph.estimator import estimate
from fvslam_graph.sequences.open import open_sequence

CHANGES = {  # of those that not all modes read
    "slam.min_landmarks": 12,
    "fusion.weight": 0.2,
    "fusion.geodesic": True,
    "fusion.criterion": "trace",
    "graph.kernel": "none",
}


@pytest.fixture(scope="module")
def poses():
    sequence = open_sequence("synthetic:uav?frames=24&size=480x360")

    sequence = replace(sequence, load=cache(sequence.load))

    def run(mode: Mode, changes: dict[str, object]) -> np.ndarray:
        # Visual SLAM that has odometry as its prior knows all that odometry knows: intersection has nothing to choose.
        apart = ("slam.motion=constant_velocity", "slam.interleave=2")
        settings = [f"mode={mode}", *apart, *(f"{name}={str(value).lower()}" for name, value in changes.items())]
        return np.array([result.pose.mean.matrix() for result in estimate(sequence, load_config(settings=settings))])

    return run


@pytest.mark.parametrize("mode", list(Mode))
def test_what_a_mode_reads(mode: Mode, poses) -> None:
    as_it_is = poses(mode, {})
    unread = {name: value for name, value in CHANGES.items() if not reads(mode, name)}
    assert np.array_equal(poses(mode, unread), as_it_is)
    for name in CHANGES.keys() - unread.keys():
        assert not np.array_equal(poses(mode, {name: CHANGES[name]}), as_it_is), name


def test_groups_and_parts_of_them() -> None:
    assert reads(Mode.AVERAGE, "fusion") and reads(Mode.AVERAGE, "fusion.weight")
    assert not reads(Mode.AVERAGE, "fusion.criterion") and not reads(Mode.VO, "slam")
    assert reads(Mode.VO, "scale.ground.patches") and not reads(Mode.VO, "scal")
