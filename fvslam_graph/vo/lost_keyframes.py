"""Keyframes that were lost not long ago: the camera may see them again."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from fvslam_graph.core.tracks import FeatureTracker
from fvslam_graph.vo.fixed_points import FixedPoints
from fvslam_graph.vo.motion_measurement import Keyframe

MEMORY = 3.0  # seconds for which a lost keyframe is looked for,
REMEMBERED = 2  # and so many of them


@dataclass(frozen=True)
class LostKeyframe:
    """A keyframe with all that it takes to go on from it.

    Attributes:
        keyframe: Its image and map.
        tracker: Finds its points.
        fixed: Tells which of them may be fixed to the camera.
        stamp: Until when it was tracked.
        scale_known: Whether the map is in the scale of the run.
    """

    keyframe: Keyframe
    tracker: FeatureTracker
    fixed: FixedPoints
    stamp: float
    scale_known: bool


class LostKeyframes:
    """The last few, for some seconds."""

    def __init__(self) -> None:
        self._keyframes: deque[LostKeyframe] = deque(maxlen=REMEMBERED)

    @property
    def indices(self) -> tuple[int, ...]:
        """Indices of their frames."""
        return tuple(lost.keyframe.frame.index for lost in self._keyframes)

    def add(self, keyframe: LostKeyframe) -> None:
        """Remember one more."""
        self._keyframes.append(keyframe)

    def remembered(self, stamp: float) -> list[LostKeyframe]:
        """Those that are not forgotten at a time, the oldest first."""
        while self._keyframes and stamp - self._keyframes[0].stamp > MEMORY:
            self._keyframes.popleft()
        return list(self._keyframes)
