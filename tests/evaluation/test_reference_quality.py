"""A reference that errs more than the estimate is found out; one that shows what the camera did is not."""

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.metrics import EstimateDetails, evaluate
from fvslam_graph.runs.results import Relatives

SIGMAS = np.repeat([1e-4, 0.002], 3)  # of the estimated motions: rad, m
COUNT = 300


def shaken(rng: np.random.Generator) -> Trajectory:
    """A path with real shaking, ten times what motions are estimated to; the stamps are uneven."""
    stamps = 0.1 * np.arange(COUNT) + rng.uniform(0, 0.03, COUNT)
    poses = [
        gtsam.Pose3(gtsam.Rot3.Ypr(0.3 * np.sin(t), 0, 0), np.array([np.sin(t / 3), 0.1 * np.sin(t / 2), 2 * t]))
        * gtsam.Pose3.Expmap(10 * SIGMAS * rng.standard_normal(6))
        for t in stamps
    ]
    return Trajectory(stamps, tuple(poses))


def evaluation(reference_sigmas: np.ndarray, estimate_gain: float = 1.0, tilt: float = 0.0):
    """Of estimated motions whose errors are `estimate_gain` times what they claim, against a reference with noise."""
    rng = np.random.default_rng(0)
    truth = shaken(rng)
    steps = [gtsam.Pose3()]
    for a, b in zip(truth.poses, truth.poses[1:], strict=False):
        steps.append(a.between(b) * gtsam.Pose3.Expmap(estimate_gain * SIGMAS * rng.standard_normal(6)))
    path = [gtsam.Pose3()]
    for step in steps[1:]:
        path.append(path[-1] * step)
    covariances = np.tile(np.diag(SIGMAS**2), (COUNT, 1, 1))
    covariances[0] = np.nan
    relatives = Relatives(np.maximum(np.arange(COUNT) - 1, 0), np.array([step.matrix() for step in steps]), covariances)
    body = gtsam.Pose3(gtsam.Rot3.Rx(tilt), np.zeros(3))
    noisy = tuple(pose * gtsam.Pose3.Expmap(reference_sigmas * rng.standard_normal(6)) * body for pose in truth.poses)
    details = EstimateDetails(relatives=relatives)
    return evaluate(Trajectory(truth.stamps, tuple(path)), Trajectory(truth.stamps, noisy), Alignment.SE3, details)


def test_real_shaking_is_no_noise_of_the_reference() -> None:
    found = evaluation(np.zeros(6))
    assert found.reference.rotation < 1e-4 and found.reference.position < 2e-3 and found.reference.tilt == 0
    assert {part: nees.dof for part, nees in found.nees.items()} == {"pose": 6, "rotation": 3, "direction": 2}
    for nees in found.nees.values():
        assert nees.judged and nees.low < nees.mean < nees.high  # chi-square with this seed; measured 6.0, 3.0, 2.0
    assert not any("judge" in note for note in found.notes)


def test_a_noisy_estimate_is_no_excuse() -> None:
    found = evaluation(np.zeros(6), estimate_gain=10)
    assert all(nees.judged and nees.mean > 50 * nees.dof for nees in found.nees.values())


@pytest.mark.parametrize("gain", [5.0, 20.0])
def test_the_noise_of_a_reference_is_measured(gain: float) -> None:
    found = evaluation(gain * SIGMAS)
    assert found.reference.rotation == pytest.approx(gain * SIGMAS[0], rel=0.35)  # measured within 11 %
    assert found.reference.position == pytest.approx(gain * SIGMAS[3], rel=0.35)
    for nees in found.nees.values():
        assert not nees.judged
        assert nees.mean - nees.dof == pytest.approx(
            nees.added, rel=0.7
        )  # it explains what is too much; measured within 30 %
    (note,) = [note for note in found.notes if "judge" in note]
    assert note.startswith("the reference cannot judge the NEES of pose, rotation, direction: it errs by ")


def test_noisy_positions_leave_rotations_to_be_judged() -> None:
    found = evaluation(np.repeat([0.0, 0.04], 3))
    assert {part: nees.judged for part, nees in found.nees.items()} == {
        "pose": False,
        "rotation": True,
        "direction": False,
    }
    assert found.nees["rotation"].low < found.nees["rotation"].mean < found.nees["rotation"].high


def test_axes_that_are_not_the_cameras() -> None:
    found = evaluation(np.zeros(6), tilt=np.radians(13))
    assert np.degrees(found.reference.tilt) == pytest.approx(13, abs=1)
    assert not any(nees.judged for nees in found.nees.values())
    assert any(note.endswith("its axes are turned from the camera's by 13 deg") for note in found.notes)
    assert evaluation(np.zeros(6), tilt=np.radians(0.5)).reference.tilt == 0
