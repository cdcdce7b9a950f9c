"""Points that do not move in the image while most do: parts of the vehicle, letters of a display, dirt on the lens."""

from __future__ import annotations

import numpy as np

from fvslam_graph.core.quick import median
from fvslam_graph.core.tracks import Tracks

STILL = 0.5  # pixels from where it was first seen, within which a point has not moved
MOVING = 5.0  # pixels, median over the other points since the keyframe: with more, what is still is suspicious


class FixedPoints:
    """Tells which points may be fixed to the camera.

    Such a point agrees with every motion straight ahead, as one on the horizon does, and holds the rotation at zero.
    Once it has moved, it is a point of the scene; until then it tells nothing, as soon as most others have moved. What
    is far away moves with the smallest rotation.
    """

    def __init__(self) -> None:
        self.tracks = Tracks.none()  # those of the last image that may be fixed
        self._ids = np.empty(0, np.int64)
        self._first = np.empty((0, 2))  # pixels where they were first seen
        self._moved, self._suspicious = np.empty(0, bool), np.empty(0, bool)

    def without(self, tracks: Tracks) -> Tracks:
        """The tracks of the next image that are of the scene."""
        _, mine, theirs = np.intersect1d(self._ids, tracks.ids, assume_unique=True, return_indices=True)
        first, moved, suspicious = tracks.keyframe.copy(), np.zeros(len(tracks), bool), np.zeros(len(tracks), bool)
        first[theirs], moved[theirs], suspicious[theirs] = self._first[mine], self._moved[mine], self._suspicious[mine]
        moved |= np.hypot(*(tracks.current - first).T) > STILL
        fixed = suspicious & ~moved
        others = np.hypot(*(tracks.current - tracks.keyframe)[~fixed].T)
        if len(others) and median(others) > MOVING:
            suspicious[:] = True
        self._ids, self._first, self._moved, self._suspicious = tracks.ids, first, moved, suspicious
        fixed = suspicious & ~moved
        self.tracks = tracks[fixed]
        return tracks[~fixed] if fixed.any() else tracks
