"""The principled fusion: motions of odometry and landmarks of visual SLAM in one factor graph."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.errors import EstimationError
from fvslam_graph.core.frame_result import CalibrationEstimate, ClockEstimate, HeightEstimate
from fvslam_graph.core.gaussian_pose import GaussianPose, ScaledPose
from fvslam_graph.core.sequence import Ground
from fvslam_graph.core.slam_estimate import LandmarkObservations
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.core.vo_estimate import CalibrationEvidence, OdometryStep
from fvslam_graph.graph.calibration import (
    CALIBRATION,
    calibration_estimate,
)
from fvslam_graph.graph.export import write_graph
from fvslam_graph.graph.factors import (
    CLOCK,
    ENU,
    HEIGHT,
    LASTING,
    SHORT,
    LandmarkFactors,
    calibrated_motion_factors,
    filed_key,
    gravity_factor,
    height_factor,
    is_pose,
    landmark_key,
    length_factor,
    motion_factor,
    pose_factor,
    pose_key,
)
from fvslam_graph.graph.fix_factors import GraphFix, KnownPath
from fvslam_graph.graph.gating import contradiction
from fvslam_graph.graph.landmark_candidates import LandmarkCandidates, LandmarkObservation
from fvslam_graph.graph.pending_update import PendingUpdate
from fvslam_graph.graph.pixel_noise import PixelNoise
from fvslam_graph.graph.positions import Positions
from fvslam_graph.graph.scale_chain import ScaleChain
from fvslam_graph.graph.solver import Solver

Array = NDArray[np.float64]

MAX_DISPLACEMENT = 0.5  # deviations of a position
RECENT = 60  # frames before the last fusion whose poses the next one can still use


class Graph:
    """A pose for every frame, a point for every landmark; the first pose is known.

    Frames come by `add_odometry`. At an interleaved frame, `fuse` takes in the landmarks and solves.

    Args:
        camera: Undistorted.
        settings: Which factors, how robust, how long they are kept.
        relative: Nothing tells metres: the first scale of odometry is taken as it is.
        ground: What is known of which way is down.
    """

    def __init__(
        self, camera: Camera, settings: GraphSettings, relative: bool = False, ground: Ground | None = None
    ) -> None:
        self.settings = settings
        self.solver = Solver(settings)
        self._camera = self._refined = camera  # as its file has it, and as it is known now
        self._landmark_factors = LandmarkFactors(camera, settings)
        self._candidates = LandmarkCandidates(settings)
        self._noise = PixelNoise(settings.pixel_sigma)
        self._update = PendingUpdate(self.solver)
        self._scales = ScaleChain(self._update, self._landmark_factors.calibration, relative)
        self._positions = Positions(self._update, settings, ground)
        self._counts: dict[int, int] = {}  # landmarks that each interleaved frame shows
        self._distances: dict[int, float] = {}  # metres, of each landmark of the graph when it was seen first
        self._stamps: list[float] = []  # of all frames
        self._poses: list[gtsam.Pose3] = []  # world_T_camera of all frames, as known last
        self._drift_variances: list[Array] = []  # (2, 2) of all frames, see `LandmarkCandidates.ready`
        self._moves: dict[int, OdometryStep] = {}  # since the last fusion, by frame
        self._fused = 0  # the frame of the last reference P_f
        self._observations: LandmarkObservations | None = None  # of that frame
        self._start_height = math.nan
        self._down: Array | None = None  # (3,) in the world, by the first reading of gravity
        if settings.landmarks == "projection":
            for factor in self._landmark_factors.calibration.priors():
                self.add(factor)
            self._update.insert(CALIBRATION, self._landmark_factors.calibration.start)

    def add_odometry(self, stamp: float, step: OdometryStep) -> None:
        """Append the next frame, at `stamp` seconds, with its motion since an earlier one."""
        previous, motion, index = step.previous, step.prev_T_cur, len(self._poses)
        self._stamps.append(stamp)
        if index == 0:
            self._poses.append(gtsam.Pose3())
            self._drift_variances.append(np.zeros((2, 2)))
            self.add(pose_factor(0, GaussianPose.identity()))
            self._update.insert(pose_key(0), gtsam.Pose3())
        else:
            self._poses.append(self._poses[previous].compose(motion.mean))
            if self.settings.lag is not None and stamp - self._stamps[previous] > self.settings.lag:
                # What odometry refers to is no longer kept: a camera that stands still has an old reference.
                previous = index - 1
                motion = GaussianPose(_between(self._poses[previous], self._poses[index]), motion.covariance)
                step = OdometryStep(previous, motion)
            own = motion.with_scale_variance(-step.scale_variance)  # a scale in common displaces no landmark
            start = self._drift_variances[previous][0]
            self._drift_variances.append(np.array([start + np.diag(own.covariance).reshape(2, 3).max(axis=1), start]))
            self._moves[index] = step
        self._update.stamps[pose_key(index)] = stamp

    def add_height(self, height: float, sigma: float, down: Array) -> None:
        """A reading of the height above level ground (m), at the newest frame; `down` (3,) in the first camera."""
        if math.isnan(self._start_height):
            self._start_height = height
        self.add(height_factor(len(self._poses) - 1, height - self._start_height, math.sqrt(2) * sigma, down))

    def add_gravity(self, down: Array) -> None:
        """The direction of gravity (3,), in the newest camera."""
        frame = len(self._poses) - 1
        if self._down is None:
            self._down = self._poses[frame].rotation().rotate(down)
        self.add(gravity_factor(frame, self._down, down))

    def add_position(self, stamp: float, enu: Array, sigmas: Array) -> None:
        """A position east, north, up (3,), metres, with its standard deviations and its time by the receiver."""
        self._positions.add(GraphFix(stamp, enu, sigmas))

    def add_calibration(self, evidence: CalibrationEvidence) -> None:
        """What images say of the calibration of the file, apart from the motions and landmarks of this graph."""
        if self._update.has(CALIBRATION):
            self.add(self._landmark_factors.calibration.measured(evidence))

    def add(self, factor: gtsam.NonlinearFactor) -> None:
        """Anything else that is known of poses, see `factors`; it takes effect when the graph is solved next."""
        self._update.add(factor)

    def fuse(self, observations: LandmarkObservations | None) -> GaussianPose | None:
        """Take in what the newest frame shows of landmarks, and solve.

        Motions that landmarks contradict are replaced by what these say.

        Returns:
            The motion since the last call (since the first frame, at the first one), with its marginal covariance; None
            where the lag has left that frame behind.
        """
        index = len(self._poses) - 1
        self._take_motions(observations)
        if self._take_positions():
            self._keep_kernels_right()
        if observations is not None and self.settings.landmarks != "none":
            self._see(index, observations)
        self._solve()
        if observations is not None:
            self._learn(observations)
        first, self._fused, self._observations = self._fused, index, observations
        if not self.has(first):
            return None
        return _motion(self.solver, pose_key(first), pose_key(index), self._poses[first], self._poses[index])

    def has(self, frame: int) -> bool:
        """Whether the pose of a frame is in the graph that was solved last, and not beyond the lag."""
        return self.solver.has(pose_key(frame))

    def pose(self, frame: int) -> GaussianPose:
        """Where the graph has the camera at one of the newest frames, as it was solved last."""
        return GaussianPose(self._poses[frame], self.solver.covariance(pose_key(frame)))

    def positions(self, frames: list[int]) -> Array:
        """Where the camera was in N frames as known now, (N, 3) in the world, metres."""
        return np.array([self._pose(frame).translation() for frame in frames])

    @property
    def world_T_enu(self) -> gtsam.Pose3 | None:
        """Where east, north, up is in the world; None before positions tell it."""
        return self.solver.pose(ENU) if self.solver.has(ENU) else None

    def enu_T_world(self) -> GaussianPose | None:
        """Where the world is on Earth, with its marginal covariance."""
        if self.world_T_enu is None:
            return None
        return GaussianPose(self.world_T_enu, self.solver.covariance(ENU)).inverse()

    def enu_T_camera(self, frame: int) -> GaussianPose | None:
        """Where the camera is on Earth at one of the newest frames, with its marginal covariance."""
        if self.world_T_enu is None or not self.has(frame):
            return None
        return _motion(self.solver, ENU, pose_key(frame), self.world_T_enu, self._poses[frame])

    @property
    def clock(self) -> ClockEstimate | None:
        """How far the clock of the fixes is off; None before they tell where the world is."""
        if not self.solver.has(CLOCK):
            return None
        return ClockEstimate(self.solver.number(CLOCK), math.sqrt(self.solver.covariance(CLOCK)[0, 0]))

    @property
    def height(self) -> HeightEstimate | None:
        """How far the given height above the ground is off; None where it is exact, or each one is measured."""
        if not self.solver.has(HEIGHT):
            return None
        factor = math.exp(self.solver.number(HEIGHT))
        return HeightEstimate(factor, factor * math.sqrt(self.solver.covariance(HEIGHT)[0, 0]))

    @property
    def frames(self) -> int:
        """How many there are."""
        return len(self._poses)

    @property
    def calibration(self) -> CalibrationEstimate | None:
        """The camera as landmarks tell it; None where they do not."""
        if not self.solver.has(CALIBRATION):
            return None
        return calibration_estimate(self.solver.calibration(), self.solver.covariance(CALIBRATION))

    def smoothed(self) -> Trajectory:
        """All poses, by all measurements; those that a fixed lag has left behind, as they were when they left.

        Poses that are not determined are left out.

        Raises:
            EstimationError: The graph cannot be solved.
        """
        try:
            self._take_motions(None)
            self._take_positions()
            if self._update.factors.size():
                self._solve()
            self.solver.optimize()
            if self.settings.lag is None:
                self._time_again()
            estimate = self.solver.values()
        except (RuntimeError, ValueError, IndexError) as error:  # as which GTSAM's exceptions arrive
            raise EstimationError(f"the factor graph cannot be solved: {' '.join(str(error).split())}") from None
        poses = dict(enumerate(self._poses))
        poses |= {gtsam.Symbol(key).index(): estimate.atPose3(key) for key in estimate.keys() if is_pose(key)}  # noqa: SIM118
        known = [frame for frame, pose in poses.items() if np.isfinite(pose.matrix()).all()]
        return Trajectory(np.array(self._stamps)[known], tuple(poses[frame] for frame in known))

    def write(self, folder: Path) -> None:
        """Write the graph into a folder, see `write_graph`."""
        estimate = self.solver.values()
        write_graph(folder, self.solver.factors(), estimate, self._scales.lengths(estimate))

    def _pose(self, frame: int) -> gtsam.Pose3:
        """Where the camera was in a frame, as known now."""
        if self.has(frame):
            self._poses[frame] = self.solver.pose(pose_key(frame))
        return self._poses[frame]

    def _take_motions(self, observations: LandmarkObservations | None) -> None:
        """Append what odometry says since the last fusion.

        Where landmarks contradict it, where they have the camera stands in its place. In between, velocity is taken to
        be constant, which is as uncertain as the two differ.
        """
        newest = len(self._poses) - 1
        recent = newest in self._moves and self._update.has(pose_key(self._fused))  # not beyond the lag
        if recent and (seen := self._contradiction(newest, observations)):
            doubt = np.diag(gtsam.Pose3.Logmap(self._poses[newest].between(seen.mean)) ** 2)
            start, begin = self._poses[self._fused], self._stamps[self._fused]
            whole = GaussianPose(_between(start, seen.mean), seen.covariance)
            self.add(motion_factor(self._fused, newest, whole, self.settings))
            velocity = gtsam.Pose3.Logmap(whole.mean) / (self._stamps[newest] - begin)
            for index in self._moves:
                self._poses[index] = start.compose(gtsam.Pose3.Expmap(velocity * (self._stamps[index] - begin)))
            for index, step in self._moves.items():
                motion = GaussianPose(_between(self._poses[step.previous], self._poses[index]), doubt)
                self._moves[index] = OdometryStep(step.previous, motion)
        scales = self._take_scales()
        for index, step in self._moves.items():
            if index in scales:
                step = step.longer(math.exp(self._scales.expected(scales[index])))
            start = self._update.linearised(pose_key(step.previous))
            self._update.insert(pose_key(index), start.compose(step.prev_T_cur.mean))
            self._move(index, step, scales.get(index))
        self._moves = {}

    def _take_scales(self) -> dict[int, int]:
        """Append what new motions say of the scale; the variable of each one that has it in common, by frame."""
        scales = {}
        for index, step in self._moves.items():
            if self.settings.scale_model == "chain" and step.scale_variance > 0:
                scales[index], *others = self._scales.extend(index, step)
                for key in (scales[index], *others):
                    self._update.stamps[key] = self._stamps[index]
        self._scales.settle()
        return scales

    def _take_positions(self) -> bool:
        """Append what fixes say; whether they say anything."""
        return self._positions.take(KnownPath(self._stamps, self._pose), self.world_T_enu, self._clock_offset)

    @property
    def _clock_offset(self) -> float:
        return self.solver.number(CLOCK) if self.solver.has(CLOCK) else 0.0

    def _time_again(self) -> None:
        """Take in fixes at the times that the clock tells now, about which the camera moves evenly."""
        if keys := self._positions.release(self._clock_offset):
            self._take_positions()
            self.solver.forget(keys)
            self._solve()
            self.solver.optimize()

    def _contradiction(self, index: int, observations: LandmarkObservations | None) -> GaussianPose | None:
        """Where landmarks have the camera, if motions that were not taken in yet do not lead there.

        They are where visual SLAM had them at the last fusion: what is wrong since has not come to its map.
        """
        if observations is None or self._observations is None:
            return None
        step = self._moves[index]
        motion = ScaledPose.of(step.prev_T_cur, step.scale_variance)
        while step.previous in self._moves:
            step = self._moves[step.previous]
            motion = ScaledPose.of(step.prev_T_cur, step.scale_variance).compose(motion)
        expected = GaussianPose(self._poses[index], motion.total.covariance)
        _, before, now = np.intersect1d(self._observations.ids, observations.ids, return_indices=True)
        points = self._poses[self._fused].transformFrom(self._observations.points[before].T).T
        deviation, sigma = self._landmark_factors.deviation, self._noise.sigma
        seen = contradiction(expected, points, observations.pixels[now], self._camera, deviation(sigma, 1), index)
        # The common error of all landmarks is averaged out by no number of them.
        inflation = (deviation(sigma, len(observations.ids)) / deviation(sigma, 1)) ** 2
        return None if seen is None else GaussianPose(seen.mean, inflation * seen.covariance)

    def _move(self, index: int, step: OdometryStep, scale: int | None) -> None:
        """The factors of a motion of odometry; the variable of its scale, if it has one."""
        motion, told = step.prev_T_cur, False
        length = float(np.linalg.norm(motion.mean.translation()))
        if scale is not None:
            motion = motion.with_scale_variance(-step.scale_variance)
            told = self._scales.measure(step.previous, index, scale, motion, self._poses[step.previous])
        elif self.settings.odometry == "essential" and length > SHORT:
            travel = motion.mean.rotation().unrotate(motion.mean.translation() / length)
            sigma = math.sqrt(float(travel @ motion.covariance[3:, 3:] @ travel))
            self.add(length_factor(step.previous, index, length, sigma))
        if self.settings.odometry == "between" and self._update.has(CALIBRATION) and step.J_calibration.any():
            step, start = replace(step, prev_T_cur=motion), self._update.linearised(pose_key(index))
            calibration = self._landmark_factors.calibration
            for factor in calibrated_motion_factors(index, step, self.settings, calibration, start, length=not told):
                self.add(factor)
            self._update.insert(filed_key(index), start)
            self._update.stamps[filed_key(index)] = self._stamps[index]
        else:
            self.add(motion_factor(step.previous, index, motion, self.settings, length=not told))

    def _see(self, index: int, observations: LandmarkObservations) -> None:
        """Landmarks of the graph are seen again; others enter once they are known well enough."""
        self._counts[index] = len(observations.ids)
        known = np.array([landmark in self._distances for landmark in observations.ids.tolist()], bool)
        for n in np.flatnonzero(known):
            landmark = int(observations.ids[n])
            if self._near(landmark, observations.points[n]) and self.solver.has(landmark_key(landmark)):
                self._observe(landmark, LandmarkObservation.of(observations, n, index))
        for candidate in self._candidates.ready(
            observations, known, self._poses, self._drift_variances, self._update.has, self._refined
        ):
            away = candidate.position - self._poses[candidate.observations[0].frame].translation()
            self._distances[candidate.landmark] = float(np.linalg.norm(away))
            if self.settings.landmarks == "smart":
                seen = [(view.frame, view.pixel) for view in candidate.observations]
                self.add(self._landmark_factors.smart(seen, self._noise.sigma, self._counts[index]))
                continue
            seen_at = self._poses[index].transformTo(candidate.position)
            point = self._update.linearised(pose_key(index)).transformFrom(seen_at)
            self._update.insert(landmark_key(candidate.landmark), point)
            for view in candidate.observations:
                self._observe(candidate.landmark, view)

    def _keep_kernels_right(self) -> None:
        """Have all linearised again where positions would be held against a place on Earth that has moved since."""
        key = pose_key(self._fused)
        if self.world_T_enu is not None and self.has(self._fused):
            there = self.solver.linearised(ENU).transformTo(self.solver.linearised(key).translation())
            now = self.world_T_enu.transformTo(self._poses[self._fused].translation())
            if np.linalg.norm(now - there) > MAX_DISPLACEMENT * self._positions.least_sigma:
                self.solver.linearise_again()

    def _learn(self, observations: LandmarkObservations) -> None:
        """How well the landmarks that are seen now fit where the graph has them."""
        keys = {landmark: landmark_key(landmark) for landmark in observations.ids.tolist()}
        points = {landmark: self.solver.point(key) for landmark, key in keys.items() if self.solver.has(key)}
        self._noise.learn(points, self._poses, self._refined)

    def _near(self, landmark: int, point: Array) -> bool:
        """Whether a landmark looks as it did at first: it is about as far away."""
        ratio = float(np.linalg.norm(point)) / self._distances[landmark]
        return 1 / self.settings.max_zoom < ratio < self.settings.max_zoom

    def _observe(self, landmark: int, view: LandmarkObservation) -> None:
        if self.settings.landmarks == "projection":
            count = self._counts[view.frame]
            self.add(self._landmark_factors.projection(view.frame, landmark, view.pixel, self._noise.sigma, count))
            self._noise.see(landmark, view.frame, view.pixel)
        elif not np.isnan(view.point).any():
            self.add(self._landmark_factors.bearing_range(view.frame, landmark, view.point, view.covariance))
        self._update.stamps[landmark_key(landmark)] = self._stamps[-1]

    def _solve(self) -> None:
        newest = pose_key(len(self._stamps) - 1)
        for lasting in filter(self._update.has, (*LASTING, newest)):
            self._update.stamps[lasting] = self._stamps[-1]  # within any lag
        self._update.solve()
        if self.solver.has(CALIBRATION):
            self._refined = self._landmark_factors.calibration.camera(self.solver.calibration())
        for index in range(max(self._fused - RECENT, 0), len(self._poses)):
            if self.has(index):
                self._poses[index] = self.solver.pose(pose_key(index))
        if self.settings.lag is not None:
            self._scales.forget()
            within = (item for item in self._distances.items() if self.solver.has(landmark_key(item[0])))
            self._distances = dict(within)


def _between(a: gtsam.Pose3, b: gtsam.Pose3) -> gtsam.Pose3:
    """The motion a_T_b, to go on from another pose.

    Of rotations, each made of the one before and of itself, rounding errors would double with each frame.
    """
    motion = a.between(b)
    return gtsam.Pose3(gtsam.Rot3.ClosestTo(motion.rotation().matrix()), motion.translation())


def _motion(solver: Solver, first: int, second: int, a: gtsam.Pose3, b: gtsam.Pose3) -> GaussianPose:
    """a_T_b with its marginal covariance, from the keys and estimates of two poses."""
    motion = a.between(b)
    J_poses = np.hstack([-motion.inverse().AdjointMap(), np.eye(6)])
    covariance = J_poses @ solver.joint_covariance(first, second) @ J_poses.T
    return GaussianPose(motion, (covariance + covariance.T) / 2)
