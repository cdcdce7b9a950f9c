"""Estimators on simulated points, without images: whether they are right, and consistent about how wrong they are."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.config import Config, SlamSettings, load_config
from fvslam_graph.core.errors import EstimationError
from fvslam_graph.core.frame_result import FrameResult
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.sequence import Frame
from fvslam_graph.core.slam_estimate import SlamEstimate
from fvslam_graph.core.trajectory import Status
from fvslam_graph.core.vo_estimate import OdometryMotion
from fvslam_graph.estimator import FrameEstimator, FrontEnd, through
from fvslam_graph.evaluation.nees import Consistency, consistency
from fvslam_graph.fusion.rules import FusionRule, OutsideRule
from fvslam_graph.simulation.points import PointScene, simulate_drive
from fvslam_graph.simulation.scene_finder import SceneFinder, known_points
from fvslam_graph.simulation.scene_tracker import SceneTracker
from fvslam_graph.slam.vslam import VSlam
from fvslam_graph.vo.scale import ORACLE_VARIANCE

DEPTH_SIGMA = 0.05  # of the logarithm of the first landmarks' inverse depths, each on its own
COMMON_SCALE_SIGMA = 0.03  # of the logarithm of the scale that they share
RULE_NOISE = 0.5  # pixels
RULE_LANDMARKS = 3000
_RULE_SETTINGS = (
    "mode=average",
    "scale.source=oracle",
    f"slam.pixel_sigma={RULE_NOISE}",
    f"vo.ransac_threshold={2 * RULE_NOISE}",  # the settings are made for trackers on images, which err by less
)
_NO_IMAGE = np.zeros((1, 1), np.uint8)  # points are found without


def run_vslam(
    scene: PointScene,
    settings: SlamSettings,
    seed: int,
    wrong: float = 0.0,
    depth_sigma: float = DEPTH_SIGMA,
    scale_sigma: float = COMMON_SCALE_SIGMA,
) -> Iterator[SlamEstimate]:
    """Visual SLAM on a scene, from the second frame on; the first two tell the velocity and the first depths.

    Args:
        scene: Landmarks and camera path.
        settings: Of the filter.
        seed: Of its random numbers, of wrong matches and of errors in the first depths and velocity.
        wrong: Share of the matches that are wrong.
        depth_sigma, scale_sigma: How wrong the first depths are.
    """
    rng = np.random.default_rng([seed, 2])
    stamps, poses = scene.trajectory.stamps, scene.trajectory.poses
    vslam = VSlam(scene.camera, settings, SceneFinder(scene, wrong, seed), np.random.default_rng(seed))
    seconds = float(stamps[1] - stamps[0])
    # The velocity is as uncertain as the motion model leaves it over one step.
    sigmas = np.repeat([settings.angular_noise, settings.linear_noise], 3) * seconds**1.5
    moved = poses[0].between(poses[1]).retract(sigmas * rng.standard_normal(6))
    start = GaussianPose(poses[1], np.zeros((6, 6)))
    points = known_points(scene, 1, depth_sigma, scale_sigma, rng)
    motion = OdometryMotion(GaussianPose(moved, np.diag(sigmas**2)), np.zeros(6), 0.0, scale_sigma**2)
    yield vslam.start(frame_of(scene, 1), start, motion, seconds, points)
    for index in range(2, len(scene)):
        yield vslam.step(frame_of(scene, index))


def run(scene: PointScene, config: Config, wrong: float = 0.0, rule: FusionRule | None = None) -> Iterator[FrameResult]:
    """Any mode on a scene: the loop that runs on images, with other eyes.

    The scale source `oracle` errs by as much as it says; were it exact, a consistent covariance would look careful.

    Args:
        scene: Landmarks and camera path.
        config: Mode, settings and seed; the scale source `plane` needs images, so that `oracle` is for scenes.
        wrong: Share of the matches that are wrong.
        rule: Fuses, in place of that of the mode.
    """
    tracker = SceneTracker(scene, config.features.count, wrong, config.seed)
    positions = scene.trajectory.positions

    def baseline(a: int, b: int) -> float:
        error = math.sqrt(ORACLE_VARIANCE) * np.random.default_rng([config.seed, 3, a, b]).standard_normal()
        return float(np.linalg.norm(positions[b] - positions[a]) * math.exp(error))

    front_end = FrontEnd(tracker, SceneFinder(scene, wrong, config.seed), baseline)
    return through(FrameEstimator(scene.camera, config, scene.ground, front_end, rule), scene.sequence("points"))


def frame_of(scene: PointScene, index: int) -> Frame:
    """A frame of the scene, with an image that shows nothing."""
    return Frame(index, float(scene.trajectory.stamps[index]), _NO_IMAGE)


def pose_errors(
    scene: PointScene, estimates: Iterable[SlamEstimate | FrameResult]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Errors Logmap(estimate^-1 truth) of the poses (N, 6), rad and m, and their covariances (N, 6, 6)."""
    estimates = list(estimates)
    errors = [
        gtsam.Pose3.Logmap(estimate.pose.mean.between(scene.trajectory.poses[estimate.index])) for estimate in estimates
    ]
    return np.array(errors), np.array([estimate.pose.covariance for estimate in estimates])


def rule_consistency(rule: FusionRule, seeds: int, frames: int, level: float) -> Consistency:
    """The NEES of the motions that a rule has fused, over drives through simulated points.

    Args:
        rule: Fuses at every fifth frame.
        seeds: How many drives, each with its own points, noise and path.
        frames: Of each.
        level: Of the band.

    Raises:
        EstimationError: What the rule returns is no pose, or there was nothing to fuse.
    """
    checked, errors, covariances = OutsideRule("the rule", rule), [], []
    for seed in range(seeds):
        scene = simulate_drive(frames=frames, seed=seed, noise=RULE_NOISE, landmarks=RULE_LANDMARKS)
        config = load_config(settings=[*_RULE_SETTINGS, f"seed={seed}"])
        poses = scene.trajectory.poses
        for result in filter(_is_fused, run(scene, config, rule=checked)):
            motion = poses[result.previous].between(poses[result.index])
            errors.append(gtsam.Pose3.Logmap(result.relative.mean.between(motion)))
            covariances.append(result.relative.covariance)
    if not errors:
        raise EstimationError(f"nothing was fused in {frames} frames; give more of them")
    return consistency(np.array(errors), np.array(covariances), level=level)


def _is_fused(result: FrameResult) -> bool:
    """Whether visual SLAM took its turn in the frame, and did not only begin there."""
    slam = result.slam
    return slam is not None and slam.status is Status.TRACKED and bool(slam.matches.measured.any())
