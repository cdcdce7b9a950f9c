"""Runs to export: one made by hand, whose numbers are known, and one of a graph."""

import gtsam
import numpy as np
import pytest

import fvslam_graph
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.runs.results import Relatives, Run

WORLD = "synthetic:uav?frames=40&size=320x240"
CAMERA = {"width": 640, "height": 480, "fx": 500.0, "fy": 510.0, "cx": 319.5, "cy": 239.5}


def spread_covariances(rng, count):
    factors = rng.normal(size=(count, 6, 6))
    return factors @ factors.swapaxes(1, 2) / 100


@pytest.fixture(scope="session")
def run():
    """Eight poses of a level camera, nothing of them special."""
    rng = np.random.default_rng(3)
    steps = [gtsam.Pose3()] + [gtsam.Pose3.Expmap(rng.normal(size=6) * [0.3, 0.3, 0.3, 5, 5, 5]) for _ in range(7)]
    poses = [steps[0]]
    for step in steps[1:]:
        poses.append(poses[-1].compose(step))
    return Run(
        name="flight",
        online=Trajectory(1403636579.75 + 0.05 * np.arange(8), tuple(poses)),
        smoothed=None,
        ground_truth=None,
        frames={"status": np.array(["static", *7 * ["tracked"]])},
        config={},
        info={"scale_source": "plane", "camera": CAMERA, "down": [0.0, 1.0, 0.0]},
        relatives=Relatives(
            np.maximum(np.arange(8) - 1, 0), np.array([step.matrix() for step in steps]), spread_covariances(rng, 8)
        ),
        pose_covariances=spread_covariances(rng, 8),
    )


@pytest.fixture(scope="session")
def graph_run(tmp_path_factory):
    """A short flight in mode graph, in a folder."""
    return fvslam_graph.run(WORLD, mode="graph", out=tmp_path_factory.mktemp("runs") / "graph")
