"""What the map tells of how far away things are."""

from dataclasses import replace
from unittest.mock import Mock

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import SlamSettings
from fvslam_graph.core.sequence import Frame
from fvslam_graph.slam.landmark_history import NO_TRACK
from fvslam_graph.slam.map_management import MapManager


def test_landmarks_that_may_be_endlessly_far_away_tell_no_distance(random_state, camera):
    """Most of them, as where the camera seems to go backwards; a lost camera may then be anywhere within the rest."""
    state = random_state(0, inverse=9, points=3)
    inverse_depth = state.inverse_depth.copy()
    inverse_depth[:, 2] = 1e-12
    state = replace(state, inverse_depth=inverse_depth)
    manager = MapManager(camera, SlamSettings(), Mock())
    manager.history = manager.history.begun(state.ids, 0, np.full(len(state), NO_TRACK))
    frame = Frame(0, 0.0, None)
    manager.add_landmarks(state, frame, None, gtsam.Pose3())
    assert manager.distance == pytest.approx(np.median(np.linalg.norm(state.points, axis=1)))
    before = manager.distance
    manager.add_landmarks(state.without(np.arange(12) >= 9, np.zeros(9, bool)), frame, None, gtsam.Pose3())
    assert manager.distance == before
