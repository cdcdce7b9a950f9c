"""When visual SLAM takes its turn."""

from __future__ import annotations


class InterleaveSchedule:
    """Every how many frames visual SLAM runs.

    Over a long interval the view may change so much that too few landmarks are found again (the paper's warning).

    Args:
        distance: Frames from one turn to the next.
        shorten: Whether a turn that failed halves the interval; it grows by a frame with every turn that did not.
    """

    def __init__(self, distance: int, shorten: bool) -> None:
        self._longest = distance
        self._shorten = shorten
        self.distance = distance  # now

    def report(self, well: bool) -> None:
        """Take in how a turn ended."""
        if self._shorten:
            self.distance = min(self.distance + 1, self._longest) if well else max(self.distance // 2, 1)
