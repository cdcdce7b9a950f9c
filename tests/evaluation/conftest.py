"""Run folders with known errors, written as an estimator would write them."""

from collections.abc import Callable
from pathlib import Path

import gtsam
import numpy as np
import pytest
from pydantic import BaseModel

from fvslam_graph.core.frame_result import FrameResult
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.trajectory import Status, Trajectory
from fvslam_graph.runs.run_folder import RunWriter

WORLD_T_START = gtsam.Pose3(gtsam.Rot3.Ypr(2.0, 0.3, -0.4), np.array([120.0, -40.0, 7.0]))
SIGMAS = np.repeat([2e-4, 0.01], 3)  # of each step: rad, m

MakeRun = Callable[..., Path]


class Settings(BaseModel):
    detector: str = "fast"
    levels: int = 3


def drive(count: int, step: float = 1.0) -> Trajectory:
    """A car's winding path at 10 Hz, `step` metres a frame, in a world whose axes are not the camera's."""
    turns = 0.02 * np.sin(np.arange(count - 1) / 25)
    poses = [WORLD_T_START]
    for turn in turns:
        poses.append(poses[-1] * gtsam.Pose3(gtsam.Rot3.Ry(turn), np.array([0.0, 0.0, step])))
    return Trajectory(0.1 * np.arange(count), tuple(poses))


@pytest.fixture
def make_run(tmp_path: Path) -> MakeRun:
    """Writes a run that follows `truth`; every step has noise of SIGMAS and a covariance that says so."""

    def make(
        name: str = "run",
        truth: Trajectory | None = None,
        seed: int = 0,
        gain: float = 1.0,
        ground_truth: bool = True,
        stop: BaseException | None = None,
        **metadata: object,
    ) -> Path:
        truth = drive(250) if truth is None else truth
        rng = np.random.default_rng(seed)
        metadata = {"sequence": "drive", "frames": len(truth), "mode": "vo", "scale_source": "plane", **metadata}
        folder = tmp_path / name
        with RunWriter(folder, Settings(), metadata, truth if ground_truth else None) as writer:
            pose = GaussianPose.identity()
            for index, stamp in enumerate(truth.stamps):
                relative, covariance = gtsam.Pose3(), np.full((6, 6), np.nan)
                if index:
                    exact = truth.poses[index - 1].between(truth.poses[index])
                    exact = gtsam.Pose3(exact.rotation(), gain * exact.translation())
                    relative = exact * gtsam.Pose3.Expmap(SIGMAS * rng.standard_normal(6))
                    covariance = np.diag(SIGMAS**2)
                    pose = pose.compose(GaussianPose(relative, covariance))
                scale = float(np.linalg.norm(relative.translation()))
                writer.add(
                    FrameResult(
                        index=index,
                        stamp=stamp,
                        pose=pose,
                        status=Status.COASTED if 100 <= index < 110 else Status.TRACKED,
                        previous=max(index - 1, 0),
                        relative=GaussianPose(relative, covariance),
                        measures={
                            "tracks": 400 + 40 * rng.standard_normal(),
                            "inliers": 300 + 50 * np.sin(index / 20),
                            "keyframe": max(index - 1, 0),
                            "scale": scale if index else np.nan,
                            "scale_sigma": SIGMAS[5],
                        },
                        times={"detect": 3.0, "track": 5.0 + rng.random()},
                    )
                )
            if stop is not None:
                raise stop
        return folder

    return make
