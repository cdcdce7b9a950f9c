"""The motion since the last reference pose, as visual odometry has it."""

from __future__ import annotations

import numpy as np

from fvslam_graph.estimates import GaussianPose, ScaledPose


class OdometryChain:
    """Composes motions, each measured against an earlier frame, into the motion since an anchor frame.

    The first frame is the first anchor. Motions are taken as independent of each other, but for the scale of their
    lengths, and for two against the same frame. Where a motion to the anchor and one past it both begin before it, the second counts with its covariance, the
    first with none: they share the noise of the frame where they begin, and where tracks go on from where they were
    found, all of the first is in the second. As long as at least half of it is, their difference errs by no more.
    """

    def __init__(self) -> None:
        self._since: dict[int, ScaledPose] = {}  # anchor_T_frame of the newest frame and of the one before it
        self._newest = (0, 0)  # previous, index
        self._motion = GaussianPose.identity()

    @property
    def motion(self) -> ScaledPose:
        """anchor_T_frame of the newest frame."""
        return self._since[self._newest[1]]

    def add(self, index: int, previous: int, prev_T_cur: GaussianPose, scale_variance: float = 0.0) -> None:
        """Append frame `index`, whose motion was measured against frame `previous`, in a scale of this log variance."""
        nowhere = ScaledPose.of(GaussianPose.identity())
        start = self._since[previous] if previous < index else nowhere  # the first usable image
        self._since = {previous: start, index: start.compose(ScaledPose.of(prev_T_cur, scale_variance))}
        self._newest, self._motion = (previous, index), prev_T_cur

    def anchor(self) -> None:
        """Make the newest frame the anchor; motions to come may still be measured against the one before it."""
        previous, index = self._newest
        before = GaussianPose(self._motion.mean.inverse(), np.zeros((6, 6)))
        self._since = {previous: ScaledPose.of(before), index: ScaledPose.of(GaussianPose.identity())}
