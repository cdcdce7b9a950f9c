"""The motion since the last reference pose, as visual odometry has it."""

from __future__ import annotations

from fvslam_graph.estimates import GaussianPose


class OdometryChain:
    """Composes motions, each measured against an earlier frame, into the motion since an anchor frame.

    The first frame is the first anchor. Motions are taken as independent of each other.
    """

    def __init__(self) -> None:
        self._since: dict[int, GaussianPose] = {}  # anchor_T_frame of the newest frame and of the one before it
        self._newest = (0, 0)  # previous, index
        self._motion = GaussianPose.identity()

    @property
    def motion(self) -> GaussianPose:
        """anchor_T_frame of the newest frame."""
        return self._since[self._newest[1]]

    def add(self, index: int, previous: int, prev_T_cur: GaussianPose) -> None:
        """Append frame `index`, whose motion was measured against frame `previous`."""
        start = self._since[previous] if previous < index else GaussianPose.identity()  # the first usable image
        self._since = {previous: start, index: start.compose(prev_T_cur)}
        self._newest, self._motion = (previous, index), prev_T_cur

    def anchor(self) -> None:
        """Make the newest frame the anchor; motions to come may still be measured against the one before it."""
        previous, index = self._newest
        self._since = {previous: self._motion.inverse(), index: GaussianPose.identity()}
