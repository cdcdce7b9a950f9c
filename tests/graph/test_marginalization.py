"""Landmarks marginalized in one factor, against the factors themselves."""

from dataclasses import dataclass

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.graph.calibration import CALIBRATION
from fvslam_graph.graph.factors import LandmarkFactors, landmark_key, motion_factor, pose_factor, pose_key
from fvslam_graph.graph.marginalization import LandmarkMarginal, Marginalization
from fvslam_graph.graph.solver import MARGINALIZE_AFTER
from fvslam_graph.simulation.points import simulate_drive

from .conftest import MOTION

FRAMES = range(0, 10, 2)
PIXEL = 0.3


@dataclass
class Small:
    """A few poses that see the same landmarks.

    Attributes:
        motions, projections: Factors.
        landmarks: Keys.
        estimate: The optimum of all factors.
    """

    motions: gtsam.NonlinearFactorGraph
    projections: gtsam.NonlinearFactorGraph
    landmarks: list[int]
    estimate: gtsam.Values

    def whole(self) -> gtsam.NonlinearFactorGraph:
        return _graph(self.motions, self.projections)

    def poses(self) -> gtsam.Values:
        """And the camera."""
        poses = gtsam.Values()
        poses.insert(CALIBRATION, self.estimate.atCal3Bundler(CALIBRATION))
        for frame in FRAMES:
            poses.insert(pose_key(frame), self.estimate.atPose3(pose_key(frame)))
        return poses


def _graph(*parts: gtsam.NonlinearFactorGraph) -> gtsam.NonlinearFactorGraph:
    whole = gtsam.NonlinearFactorGraph()
    for part in parts:
        whole.push_back(part)
    return whole


@pytest.fixture(scope="module")
def small() -> Small:
    scene, rng = simulate_drive(frames=10, seed=2, noise=PIXEL, landmarks=1500), np.random.default_rng(2)
    settings = GraphSettings(common_noise=0.0)
    motions, projections, values = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph(), gtsam.Values()
    poses = scene.trajectory.poses
    factors = LandmarkFactors(scene.camera, settings)
    motions.add(pose_factor(0, GaussianPose.identity()))
    for prior in factors.calibration.priors():
        motions.add(prior)
    values.insert(CALIBRATION, factors.calibration.start)
    for frame in FRAMES:
        values.insert(pose_key(frame), poses[frame])
        if frame:
            motion = poses[frame - 2].between(poses[frame]).retract(MOTION * rng.standard_normal(6))
            motions.add(motion_factor(frame - 2, frame, GaussianPose(motion, np.diag(MOTION**2)), settings))
    seen = [scene.observe(frame) for frame in FRAMES]
    shared = sorted(set.intersection(*(set(frame.ids.tolist()) for frame in seen)))[:30]
    for landmark in shared:
        values.insert(landmark_key(landmark), poses[0].transformFrom(scene.in_camera(0)[landmark]))
        for frame, observed in zip(FRAMES, seen, strict=True):
            pixel = observed.pixels[np.searchsorted(observed.ids, landmark)]
            projections.add(factors.projection(frame, landmark, pixel, PIXEL, len(shared)))
    optimum = gtsam.LevenbergMarquardtOptimizer(_graph(motions, projections), values).optimize()
    return Small(motions, projections, [landmark_key(landmark) for landmark in shared], optimum)


def test_says_the_same_of_the_poses(small):
    marginal = LandmarkMarginal(small.projections, small.landmarks, small.estimate)
    short = small.motions.clone()
    short.add(marginal.factor)
    whole = gtsam.Marginals(small.whole(), small.estimate)
    marginals = gtsam.Marginals(short, small.poses())
    without = gtsam.Marginals(small.motions, small.poses())
    for frame in FRAMES:
        covariance = whole.marginalCovariance(pose_key(frame))
        assert marginals.marginalCovariance(pose_key(frame)) == pytest.approx(covariance, rel=1e-6, abs=1e-15)
    last = pose_key(FRAMES[-1])
    assert np.trace(whole.marginalCovariance(last)) < 0.8 * np.trace(without.marginalCovariance(last))


def test_poses_and_landmarks_are_those_of_the_whole(small):
    """Made of an estimate that is off by more than landmarks tell, and solved for the poses alone."""
    rng, off = np.random.default_rng(5), gtsam.Values(small.estimate)
    for frame in FRAMES[1:]:
        off.update(pose_key(frame), off.atPose3(pose_key(frame)).retract(0.5 * MOTION * rng.standard_normal(6)))
    marginal = LandmarkMarginal(small.projections, small.landmarks, off)
    short = small.motions.clone()
    short.add(marginal.factor)
    found = gtsam.LevenbergMarquardtOptimizer(short, small.poses()).optimize()
    marginal.insert_landmarks(found)
    for frame in FRAMES:
        assert found.atPose3(pose_key(frame)).equals(small.estimate.atPose3(pose_key(frame)), 2e-3)
    whole = small.whole()
    assert whole.error(small.estimate) <= whole.error(found) < 1.02 * whole.error(small.estimate)


@pytest.mark.parametrize(("scale", "shift"), [(1.3, 0.0), (1.0, 20.0), (0.8, 5.0)])
def test_a_shift_and_a_change_of_scale_leave_it_alone(small, scale, shift):
    marginal = LandmarkMarginal(small.projections, small.landmarks, small.estimate)
    moved, poses = gtsam.Values(), small.poses()
    moved.insert(CALIBRATION, poses.atCal3Bundler(CALIBRATION))
    for frame in FRAMES:
        pose = poses.atPose3(pose_key(frame))
        moved.insert(pose_key(frame), gtsam.Pose3(pose.rotation(), scale * pose.translation() + shift))
    assert marginal.factor.error(moved) == pytest.approx(marginal.factor.error(poses), rel=1e-6)
    marginal.insert_landmarks(moved)
    assert small.projections.error(moved) == pytest.approx(small.projections.error(small.estimate), rel=1e-6)


def test_the_solver_sums_up_what_is_out_of_sight(fed):
    """Beside the batch optimum: the landmarks that are gone are where it has them, and so are the poses."""
    made = fed(frames=121, seed=1)
    solver, rms = made.graph.solver, []
    online, factors = solver.values(), solver.factors()
    landmarks = [key for key in online.keys() if gtsam.Symbol(key).chr() == ord("l")]  # noqa: SIM118
    kept = [key for key in landmarks if solver.has(key)]
    assert 2 * MARGINALIZE_AFTER < len(kept) < 0.4 * len(landmarks)  # measured 46 of 196
    solver.optimize()
    optimum = solver.values()
    batch = gtsam.LevenbergMarquardtOptimizer(factors, online).optimize()
    assert factors.error(optimum) == pytest.approx(factors.error(batch), rel=1e-5)
    assert factors.error(online) < 1.05 * factors.error(batch)  # measured 1.003 to 1.011 over five seeds
    for values in (online, batch):
        positions = np.array([values.atPose3(pose_key(index)).translation() for index in range(121)])
        rms.append(np.sqrt(((positions - made.scene.trajectory.positions) ** 2).sum(axis=1).mean()))
    assert rms[0] < 1.1 * rms[1]  # measured 0.1298 and 0.1281 m
    assert all(solver.has(key) for key in landmarks)


class _At:
    """An estimate, as `Marginalization` asks for it."""

    def __init__(self, values: gtsam.Values) -> None:
        self._values = values

    def pose(self, key: int) -> gtsam.Pose3:
        return self._values.atPose3(key)

    def point(self, key: int) -> np.ndarray:
        point: np.ndarray = self._values.atPoint3(key)
        return point

    def calibration(self) -> gtsam.Cal3Bundler:
        return self._values.atCal3Bundler(CALIBRATION)

    def has(self, key: int) -> bool:
        return bool(self._values.exists(key))


@pytest.mark.parametrize("nowhere", [np.array([0.0, 0.0, -5.0]), np.full(3, np.inf)], ids=["behind", "infinite"])
def test_a_landmark_that_is_not_determined_is_left_alone(small, nowhere):
    """A projection says nothing of what lies behind the camera."""
    values, marginalization = gtsam.Values(small.estimate), Marginalization()
    values.update(small.landmarks[3], nowhere)
    marginalization.add(small.projections, list(range(small.projections.size())))
    added, slots = marginalization.marginalize(small.landmarks, _At(values))
    assert added.size() == 1
    assert set(marginalization) == {small.landmarks[3]}
    assert len(slots) == small.projections.size() - len(FRAMES)
    poses = small.poses()
    marginalization.insert_marginalized(poses)
    assert not poses.exists(small.landmarks[3])
    assert poses.atPoint3(small.landmarks[0]) == pytest.approx(small.estimate.atPoint3(small.landmarks[0]), abs=1e-4)
