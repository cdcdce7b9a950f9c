"""Visual odometry where images are missing, tell nothing or show something else."""

from dataclasses import replace
from itertools import pairwise

import cv2
import gtsam
import numpy as np
import pytest

from fvslam_graph.core.config import load_config
from fvslam_graph.core.gaussian_pose import GaussianPose
from fvslam_graph.core.trajectory import Status
from fvslam_graph.features.detection import detect
from fvslam_graph.features.texture import Texture
from fvslam_graph.vo.odometry import MAX_FAILURES

from .conftest import texture


def statuses(estimates) -> list[Status]:
    return [estimate.status for estimate in estimates]


def length(pose: gtsam.Pose3) -> float:
    return float(np.linalg.norm(pose.translation()))


@pytest.mark.parametrize(("image", "status"), [("black", Status.COASTED), (None, Status.SKIPPED)])
def test_coasting_over_a_gap(flight, image, status):
    gap = np.zeros_like(flight.frames[0].image) if image else None
    estimates = flight.run(dict.fromkeys(range(8, 12), gap))
    assert [estimate.index for estimate in estimates if estimate.status is status] == [8, 9, 10, 11]
    assert len({estimate.previous for estimate in estimates[8:13]}) == 1  # the keyframe is kept,
    assert statuses(estimates[12:]) == [Status.TRACKED] * 8  # and found again
    assert np.linalg.norm(flight.errors(estimates[12:])[:, 3:], axis=1).max() < 0.1  # measured 0.035 m
    assert all(
        np.trace(b.prev_T_cur.covariance) > np.trace(a.prev_T_cur.covariance) for a, b in pairwise(estimates[7:12])
    )
    step = estimates[7].prev_T_cur.mean.between(estimates[8].prev_T_cur.mean)
    moved = estimates[7].prev_T_cur.compose(GaussianPose(step, np.zeros((6, 6)))).covariance
    assert np.linalg.eigvalsh(estimates[8].prev_T_cur.covariance - moved)[0] > 0  # what was uncertain before remains so
    assert flight.nees(estimates[8:12]).max() < 12.6  # within the 95 % of six degrees of freedom; measured 1.3
    assert flight.relative_lengths(estimates[8:12]) == pytest.approx(1.0, abs=0.05)


def test_the_first_images_are_missing(flight):
    estimates = flight.run(dict.fromkeys(range(3)))
    assert statuses(estimates[:5]) == [Status.SKIPPED] * 3 + [Status.STATIC, Status.TRACKED]
    assert [estimate.previous for estimate in estimates[:6]] == [0, 0, 0, 0, 3, 3]
    assert flight.relative_lengths(estimates[4:12]) == pytest.approx(1.0, abs=0.02)  # measured 0.004


def test_the_first_images_are_black(flight):
    estimates = flight.run(dict.fromkeys(range(3), np.zeros_like(flight.frames[0].image)))
    assert statuses(estimates[:3]) == [Status.STATIC, Status.COASTED, Status.COASTED]
    assert statuses(estimates[3 + MAX_FAILURES :]) == [Status.TRACKED] * (17 - MAX_FAILURES)


def test_no_image_at_all(flight):
    estimates = flight.run(dict.fromkeys(range(20)))
    assert statuses(estimates) == [Status.SKIPPED] * 20
    assert all(estimate.prev_T_cur.mean.equals(gtsam.Pose3(), 0) for estimate in estimates)


def test_another_scene_becomes_the_reference(flight):
    """Upside down from the tenth image on: nothing is found again."""
    flipped = {i: np.ascontiguousarray(flight.frames[i].image[::-1]) for i in range(10, 20)}
    estimates = flight.run(flipped)
    given_up = 10 + MAX_FAILURES - 1
    assert statuses(estimates[10 : given_up + 1]) == [Status.COASTED] * (MAX_FAILURES - 1) + [Status.REINITIALISED]
    # Upside down, the camera turns round at once; after a loss, that is as likely as anything else.
    assert statuses(estimates[given_up + 1 :]) == [Status.TRACKED] * (len(estimates) - given_up - 1)
    assert estimates[given_up].previous == 8
    assert {estimate.previous for estimate in estimates[given_up + 1 :]}.isdisjoint(range(given_up))
    # It is where the motion model says, and carries on at the speed that was known.
    assert length(estimates[given_up].prev_T_cur.mean) == pytest.approx(
        length(flight.truth(estimates[given_up])), rel=0.05
    )
    assert length(estimates[given_up + 1].prev_T_cur.mean) == pytest.approx(1.2, rel=0.1)
    # But it may have been carried away: by as much as the ground is away, some 30 m along the axis.
    sigma = np.sqrt(np.diag(estimates[given_up].prev_T_cur.covariance))
    assert np.all(sigma[:3] > 0.4) and np.all(sigma[3:] > 10)


def test_a_flash_does_not_end_the_reference(flight):
    """Two images of something else, with plenty of corners, are passed over."""
    rng = np.random.default_rng(0)
    else_where = cv2.GaussianBlur(rng.integers(0, 256, (240, 320)).astype(np.uint8), (0, 0), 0.8)
    assert len(detect(Texture.of(else_where, 1), load_config().features)) > 100
    estimates = flight.run({10: else_where, 11: else_where})
    assert statuses(estimates[10:13]) == [Status.COASTED, Status.COASTED, Status.TRACKED]
    assert np.linalg.norm(flight.errors(estimates[12:])[:, 3:], axis=1).max() < 0.1  # measured 0.022 m


def test_random_images_do_not_raise(flight):
    rng = np.random.default_rng(0)
    images = {i: rng.integers(0, 256, (240, 320)).astype(np.uint8) for i in range(20)}
    for estimate in flight.run(images) + flight.run(images, preset="paper"):
        assert np.isfinite(estimate.prev_T_cur.covariance).all()
        assert np.isfinite(estimate.prev_T_cur.mean.matrix()).all()


def test_a_lost_reference_is_found_again(slow_flight):
    """Four images of another scene, long enough for that to become the keyframe, and then the old one again."""
    frames = slow_flight.frames
    estimates = slow_flight.run({i: np.ascontiguousarray(frames[i].image[:, ::-1]) for i in range(10, 14)})
    assert Status.REINITIALISED in statuses(estimates[10:14])
    back = estimates[14]
    assert back.status is Status.TRACKED and back.previous < 10
    assert not back.awaited and estimates[13].awaited == (back.previous,)
    assert np.linalg.norm(slow_flight.errors([back])[0, 3:]) < 0.3
    assert np.trace(back.prev_T_cur.covariance) < 0.01 * np.trace(estimates[12].prev_T_cur.covariance)
    assert all(estimate.previous >= 14 for estimate in estimates[15:])


@pytest.mark.parametrize("source", ["map", "plane"])
def test_a_scale_that_is_a_guess_is_no_number_like_others(flight, source):
    """After half a minute of something else the speed is forgotten, too. The ground tells metres again, or nothing."""
    noise = texture(flight.sequence.camera, 1)
    images = {i: np.roll(noise, 90 * i, axis=1) for i in range(4, 10)}
    late = [replace(frame, stamp=frame.stamp + 30 * (frame.index > 7)) for frame in flight.frames]
    estimates = flight._replace(frames=late).run(images, settings=(f"scale.source={source}",))
    assert all(estimate.scale_known for estimate in estimates[:4])
    assert Status.REINITIALISED in statuses(estimates[4:10]) and statuses(estimates[-2:]) == [Status.TRACKED] * 2
    assert [estimate.scale_known for estimate in estimates[-2:]] == [source == "plane"] * 2
