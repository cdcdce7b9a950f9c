"""What one image shows of the motion since the keyframe."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import load_config
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.inverse_depths import InverseDepths, MetricMap
from fvslam_graph.core.sequence import Frame
from fvslam_graph.core.stopwatch import Stopwatch
from fvslam_graph.vo.motion_measurement import GUESS, Keyframe, MotionMeasurement, View
from fvslam_graph.vo.motion_model import ConstantVelocity
from fvslam_graph.vo.scale import MetricScale

DISTANCE = 10.0  # metres to where things usually are


@pytest.mark.parametrize(("guessed", "variance"), [(True, GUESS), (True, 0.01), (False, GUESS)])
@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_a_guess_by_hardly_any_parallax_is_made_anew(camera, two_views, factor, guessed, variance):
    """A map by a wrong first motion has all depths too small; a scale that was measured, or carried, stays."""
    scene = two_views(gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 0.0, 0.3])), noise=0.1)
    inverse = factor / scene.points[:, 2]
    known = MetricMap(InverseDepths.independent(scene.tracks.ids, inverse, 0.01 * inverse), variance)
    keyframe = Keyframe(Frame(0, 0.0, None), known, len(inverse), map_is_weak=True, scale_is_guessed=guessed)
    config = load_config(settings=["scale.source=map"])
    model = ConstantVelocity(config.vo)
    scale = MetricScale(config.scale, None, None)
    measurement = MotionMeasurement(camera, config.vo, scale, model, np.random.default_rng(0))
    used, expected = np.ones(len(inverse), bool), GaussianPose(gtsam.Pose3(), np.eye(6))
    view = View(keyframe, Frame(1, 0.1, None), scene.tracks, used, expected, DISTANCE, True, Stopwatch())
    motion = measurement.measure(view)
    assert motion is not None and motion.scale is not None
    if guessed and variance >= GUESS:
        assert motion.map.depths.usual == pytest.approx(1 / DISTANCE, rel=0.01)
    else:
        length = np.linalg.norm(motion.keyframe_T_cur.mean.translation())
        assert length == pytest.approx(np.hypot(1.0, 0.3) / factor, rel=0.03)
