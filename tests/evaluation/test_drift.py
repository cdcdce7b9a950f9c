import numpy as np
import pytest
from evo.core.metrics import PoseRelation, Unit
from evo.core.trajectory import PosePath3D
from evo.main_rpe import rpe

from fvslam_graph.evaluation.drift import SEGMENT_STEP, drift


def rotated(angles: np.ndarray) -> np.ndarray:
    """Poses at the origin, turned by angles about y."""
    poses = np.tile(np.eye(4), (len(angles), 1, 1))
    poses[:, 0, 0] = poses[:, 2, 2] = np.cos(angles)
    poses[:, 0, 2], poses[:, 2, 0] = np.sin(angles), -np.sin(angles)
    return poses


def straight(count: int, step: float) -> np.ndarray:
    poses = rotated(np.zeros(count))
    poses[:, 2, 3] = step * np.arange(count)
    return poses


def test_scale_error_on_a_straight_line_by_hand() -> None:
    # 2 m steps: a segment of 100 m ends after 51 steps (102 m, the first to exceed it), one of 200 m after 101 steps.
    reference, estimate = straight(121, 2.0), straight(121, 2.2)
    result = drift(estimate, reference)
    # Starts 0, 10, ..., 60 have a pose 51 steps later (7 starts); 0 and 10 have one 101 steps later.
    assert result.segments == 9
    assert result.by_length[100][0] == pytest.approx(100 * 0.2 * 51 / 100, abs=1e-9)
    assert result.by_length[200][0] == pytest.approx(100 * 0.2 * 101 / 200, abs=1e-9)
    assert result.t_rel == pytest.approx((7 * 10.2 + 2 * 10.1) / 9, abs=1e-9)
    assert result.r_rel == pytest.approx(0, abs=1e-4)


def test_heading_drift_by_hand() -> None:
    # The heading drifts by 0.001 rad a step while the positions are right: 0.101 rad at the end of the one segment,
    # which is 101 steps of 1 m, and nothing is wrong with its end as seen from its start.
    reference = straight(102, 1.0)
    estimate = rotated(0.001 * np.arange(102))
    estimate[:, :3, 3] = reference[:, :3, 3]
    result = drift(estimate, reference)
    assert result.segments == 1
    assert result.r_rel == pytest.approx(np.degrees(0.101), abs=1e-6)
    assert result.t_rel == pytest.approx(0, abs=1e-9)

    # A constant heading error turns the segment about its start: the chord of 101 m turned by 0.01 rad.
    turned = rotated(np.full(102, 0.01))
    turned[:, :3, 3] = reference[:, :3, 3]
    assert drift(turned, reference).t_rel == pytest.approx(100 * 2 * 101 * np.sin(0.005) / 100, abs=1e-9)


def test_it_does_not_depend_on_the_worlds() -> None:
    rng = np.random.default_rng(1)
    reference = rotated(0.3 * np.sin(np.arange(400) / 40))
    reference[:, :3, 3] = np.cumsum(reference[:, :3, 2], axis=0)
    estimate = reference @ rotated(0.002 * rng.standard_normal(400))
    world = rotated(np.array([1.2]))[0]
    world[:3, 3] = [100, -20, 3]
    here, there = drift(estimate, reference), drift(world @ estimate, reference)
    assert here.segments > 50
    assert there.t_rel == pytest.approx(here.t_rel, abs=1e-9)
    assert there.r_rel == pytest.approx(here.r_rel, abs=1e-6)


def test_it_agrees_with_evo() -> None:
    # With steps of 0.7 m the first pose beyond 100 m (143 steps, 100.1 m) is also the nearest to 100 m: evo's choice.
    reference = rotated(np.zeros(500))
    reference[:, 2, 3] = 0.7 * np.arange(500)
    rng = np.random.default_rng(2)
    estimate = rotated(np.cumsum(0.001 * rng.standard_normal(500)))
    estimate[:, :3, 3] = reference[:, :3, 3] + np.cumsum(0.01 * rng.standard_normal((500, 3)), axis=0)
    evo = {}
    for relation in (PoseRelation.translation_part, PoseRelation.rotation_angle_deg):
        result = rpe(
            PosePath3D(poses_se3=list(reference)),
            PosePath3D(poses_se3=list(estimate)),
            relation,
            delta=100.0,
            delta_unit=Unit.meters,
            rel_delta_tol=0.002,
            all_pairs=True,
            pairs_from_reference=True,
        )
        evo[relation] = result.np_arrays["error_array"][::SEGMENT_STEP].mean()
    t_rel, r_rel = drift(estimate, reference).by_length[100]
    assert 0.1 < t_rel < 20
    assert t_rel == pytest.approx(evo[PoseRelation.translation_part], rel=1e-9)
    assert r_rel == pytest.approx(evo[PoseRelation.rotation_angle_deg], rel=1e-6)


def test_a_short_path_has_no_drift() -> None:
    result = drift(straight(100, 1.0), straight(100, 1.0))
    assert np.isnan([result.t_rel, result.r_rel]).all()
    assert (result.segments, result.by_length) == (0, {})
