"""The motion since the last reference pose, as visual odometry has it."""

from __future__ import annotations

import numpy as np

from fvslam_graph.core.gaussian_pose import GaussianPose, ScaledPose
from fvslam_graph.core.vo_estimate import OdometryMotion, OdometryStep


class OdometryChain:
    """Composes motions, each measured against an earlier frame, into the motion since an anchor frame.

    The first frame is the first anchor. Motions are taken as independent of each other, but for the scale of their
    lengths, and for two against the same frame. Where a motion to the anchor and one past it both begin before it, the
    second counts with its covariance, the first with none: they share the noise of the frame where they begin, and
    where tracks go on from where they were found, all of the first is in the second. As long as at least half of it is,
    their difference errs by no more.
    """

    def __init__(self) -> None:
        self._since: dict[int, ScaledPose] = {}  # anchor_T_frame of those that matter
        self._newest, self._step = 0, OdometryStep(0, GaussianPose.identity())
        self._scale_variance = 0.0  # of its logarithm
        self._kept, self._added = 1.0, 0.0  # see `OdometryMotion`, since the anchor

    @property
    def motion(self) -> ScaledPose:
        """anchor_T_frame of the newest frame."""
        return self._since[self._newest]

    @property
    def motion_in_scale(self) -> OdometryMotion:
        """The same, apart from what its scale errs by."""
        motion = self.motion
        direction = np.zeros(6)
        if self._scale_variance > 0:
            direction = motion.scale_covariance / max(self._scale_variance, motion.variance)
        known = motion.total.covariance - self._scale_variance * np.outer(direction, direction)
        return OdometryMotion(GaussianPose(motion.pose.mean, known), direction, self._kept, self._added)

    def add(self, index: int, step: OdometryStep) -> None:
        """Append the motion of frame `index`."""
        self._follow_scale(step)
        nowhere = ScaledPose.of(GaussianPose.identity())
        start = self._since[step.previous] if step.previous < index else nowhere  # the first usable image
        kept = {frame: pose for frame, pose in self._since.items() if frame in step.awaited}
        motion = ScaledPose.of(step.prev_T_cur, step.scale_variance)
        if not step.scale_variance and self._since:  # the motion model goes on in the scale of the last motion
            motion = ScaledPose.of(step.prev_T_cur, self.motion.variance).replaced(step.prev_T_cur)
        self._since = kept | {step.previous: start, index: start.compose(motion)}
        self._newest, self._step = index, step

    def _follow_scale(self, step: OdometryStep) -> None:
        """How the error of the scale goes on, as that of a Kalman filter does."""
        if not step.map_variance > 0:
            return
        predicted = self._scale_variance + (step.scale.predicted.variance if step.scale else 0.0)
        kept = min(1.0, step.map_variance / predicted) if predicted > 0 else 0.0
        self._kept *= kept
        self._added = kept**2 * self._added + step.map_variance - kept**2 * self._scale_variance
        self._scale_variance = step.map_variance

    def anchor(self, moved: GaussianPose | None = None) -> None:
        """Make the newest frame the anchor; motions to come may still be measured against frames before it.

        Args:
            moved: Where it is in the old one, if something knows that better than these motions.
        """
        self._kept, self._added = 1.0, 0.0
        back = (moved or self.motion.total).inverse()
        before = self._step.prev_T_cur.inverse()
        if self._step.measured:
            before = GaussianPose(before.mean, np.zeros((6, 6)))
        self._since = {frame: ScaledPose.of(back.compose(pose.total)) for frame, pose in self._since.items()}
        self._since |= {
            self._step.previous: ScaledPose.of(before),
            self._newest: ScaledPose.of(GaussianPose.identity()),
        }
