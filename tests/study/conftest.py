"""A short flight, and jobs on it."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import load_config
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.study.jobs import Job
from fvslam_graph.study.run import run_study
from fvslam_graph.study.sources import Source
from fvslam_graph.study.spec import Study

SHORT = "synthetic:uav?frames=12&size=320x240"


@pytest.fixture(scope="session")
def job():
    """Makes a job on the short flight from settings."""

    def make(*settings: str, path: str = SHORT, preset: str = "tuned", variant: str = "", **source) -> Job:
        return Job(Source(path=path, **source), load_config(preset, settings=list(settings)), variant)

    return make


@pytest.fixture(scope="session")
def small_study(drive, tmp_path_factory):
    """Of a study with a recording, a world, other people's trajectories and a recording that is not there."""
    out = tmp_path_factory.mktemp("study")
    late = tmp_path_factory.mktemp("others") / "late.tum"
    truth = open_sequence(drive).ground_truth
    rng = np.random.default_rng(0)
    noisy = tuple(pose * gtsam.Pose3(gtsam.Rot3(), 0.02 * rng.standard_normal(3)) for pose in truth.poses[3:])
    Trajectory(truth.stamps[3:] - 0.004, noisy).write_tum(late)
    study = Study(
        name="A <small> study",
        sequences=[SHORT, {"path": str(drive), "name": "road & facades"}, str(out / "absent")],
        modes=["vo", "average"],
        seeds=2,
        external={
            "road & facades": {
                "perfect": str(drive / "groundtruth.tum"),
                "lost_100%": str(drive / "camera.yaml"),
                "late": str(late),
            }
        },
    )
    run_study(study, out, workers=1)
    return out
