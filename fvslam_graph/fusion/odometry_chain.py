"""The motion since the last reference pose, as visual odometry has it."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from fvslam_graph.estimates import GaussianPose, ScaledPose


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
        self._newest = (0, 0)  # previous, index
        self._motion, self._measured = GaussianPose.identity(), True

    @property
    def motion(self) -> ScaledPose:
        """anchor_T_frame of the newest frame."""
        return self._since[self._newest[1]]

    def add(
        self,
        index: int,
        previous: int,
        prev_T_cur: GaussianPose,
        scale_variance: float = 0.0,
        awaited: Collection[int] = (),
        measured: bool = True,
    ) -> None:
        """Append a motion.

        Args:
            index: Of its frame,
            previous: and of the frame that it was measured against.
            prev_T_cur: The motion,
            scale_variance: and how much variance of the logarithm of its length its covariance contains; 0 if unknown.
            awaited: Frames besides these two, against which motions to come may be measured.
            measured: Whether images tell it; a motion model's has no noise in common with others.
        """
        nowhere = ScaledPose.of(GaussianPose.identity())
        start = self._since[previous] if previous < index else nowhere  # the first usable image
        kept = {frame: pose for frame, pose in self._since.items() if frame in awaited}
        step = ScaledPose.of(prev_T_cur, scale_variance)
        if not scale_variance and self._since:  # the motion model goes on in the scale of the last motion
            step = ScaledPose.of(prev_T_cur, self.motion.variance).replaced(prev_T_cur)
        self._since = kept | {previous: start, index: start.compose(step)}
        self._newest, self._motion, self._measured = (previous, index), prev_T_cur, measured

    def anchor(self, moved: GaussianPose | None = None) -> None:
        """Make the newest frame the anchor; motions to come may still be measured against frames before it.

        Args:
            moved: Where it is in the old one, if something knows that better than these motions.
        """
        previous, index = self._newest
        back = (moved or self.motion.whole).inverse()
        before = self._motion.inverse()
        if self._measured:
            before = GaussianPose(before.mean, np.zeros((6, 6)))
        self._since = {frame: ScaledPose.of(back.compose(pose.whole)) for frame, pose in self._since.items()}
        self._since |= {previous: ScaledPose.of(before), index: ScaledPose.of(GaussianPose.identity())}
