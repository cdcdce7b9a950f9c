"""Points that are fixed to the camera."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.core.camera import Image
from fvslam_graph.core.config import FeatureSettings, load_config
from fvslam_graph.core.tracks import Tracks
from fvslam_graph.core.trajectory import Status
from fvslam_graph.features.klt import KltTracker
from fvslam_graph.testing import rendered
from fvslam_graph.vo.fixed_points import FixedPoints
from fvslam_graph.vo.odometry import VisualOdometry

from .conftest import texture

COUNT = 20
VEHICLE = 1_000_000  # ids from here on are of points on the vehicle
FIRST = np.random.default_rng(0).uniform(50, 400, (COUNT, 2))


def seen(moved, ids=None, keyframe=FIRST) -> Tracks:
    """Tracks of all points, of which some (COUNT,) pixels have moved to the right."""
    current = FIRST + np.outer(np.broadcast_to(moved, COUNT), [1.0, 0.0])
    return Tracks.alike(np.arange(COUNT) if ids is None else ids, keyframe, current)


def motion(fixed: int, pixels: float) -> np.ndarray:
    return np.where(np.arange(COUNT) < fixed, 0.0, pixels)


def test_what_stands_while_most_move_is_left_out():
    points = FixedPoints()
    assert points.without(seen(motion(5, 8.0))).ids.tolist() == list(range(5, COUNT))
    assert points.tracks.ids.tolist() == list(range(5))


def test_those_known_to_be_fixed_do_not_count_among_most():
    points = FixedPoints()
    points.without(seen(motion(9, 8.0)))
    later = motion(9, 8.0)
    later[9:15] = 0.0  # seen for the first time
    tracks = seen(later, ids=np.concatenate([np.arange(9), COUNT + np.arange(COUNT - 9)]))
    later[9:13] = 8.0
    assert len(points.without(tracks)) == COUNT - 9
    tracks = seen(later, ids=np.concatenate([np.arange(9), 2 * COUNT + np.arange(COUNT - 9)]))
    assert len(points.without(tracks)) == COUNT - 11


def test_before_most_have_moved_nobody_is_left_out_and_after_that_the_same_ones_are():
    points = FixedPoints()
    assert len(points.without(seen(motion(5, 2.0)))) == COUNT
    assert len(points.without(seen(motion(5, 8.0)))) == COUNT - 5
    assert len(points.without(seen(motion(5, 2.0)))) == COUNT - 5


def test_what_has_moved_once_is_of_the_scene():
    points = FixedPoints()
    points.without(seen(motion(5, 8.0)))
    far = motion(5, 8.0)
    far[0] = 1.0  # on the horizon, as the camera turns a little
    assert points.without(seen(far)).ids.tolist() == [0, *range(5, COUNT)]
    far[0] = 0.0
    assert points.without(seen(far)).ids.tolist() == [0, *range(5, COUNT)]


def test_slow_points_have_moved_since_they_were_first_seen():
    points, drift = FixedPoints(), 0.2
    for step in range(1, 4):
        current = motion(0, 8.0 * step)
        current[0] = drift * step
        before = motion(0, 8.0 * (step - 1))
        before[0] = drift * (step - 1)
        tracks = seen(current, keyframe=FIRST + np.outer(before, [1.0, 0.0]))  # each image is the next one's keyframe
        scene = points.without(tracks)
    assert 0 in scene.ids


def test_a_camera_that_stands_among_what_moves_keeps_its_points():
    points = FixedPoints()
    assert len(points.without(seen(motion(12, 8.0)))) == COUNT
    assert len(points.without(Tracks.none())) == 0


class WithVehicle:
    """Tracks points of the scene, and others that are fixed to the camera."""

    def __init__(self, count: int) -> None:
        pixels = np.random.default_rng(1).uniform((10, 180), (310, 230), (count, 2))
        fixed = Tracks.alike(VEHICLE + np.arange(count), pixels, pixels)
        self._scene = KltTracker(FeatureSettings())
        self._fixed = replace(fixed, alignment_bias=np.zeros((count, 2, 2, 2)))

    def __copy__(self) -> "WithVehicle":
        other = WithVehicle(len(self._fixed))
        other._scene = copy(self._scene)
        return other

    def track(self, image: Image) -> Tracks:
        return self._scene.track(image).joined(self._fixed)

    def set_keyframe(self, image: Image, kept: Tracks) -> Tracks:
        assert len(np.unique(kept.ids)) == len(kept)
        return self._scene.set_keyframe(image, kept[kept.ids < VEHICLE]).joined(self._fixed)


@pytest.mark.parametrize("world", ["uav", "drive"])
def test_a_quarter_of_all_tracks_on_the_vehicle_changes_nothing(world):
    flight = rendered(world, frames=15)
    alone, with_vehicle = (
        [estimate for frame in flight if (estimate := odometry.step(frame)).status is Status.TRACKED]
        for odometry in (
            VisualOdometry(flight.camera, load_config(), flight.ground, tracker=WithVehicle(count)) for count in (0, 90)
        )
    )
    assert len(alone) == len(with_vehicle) == 14
    for one, other in zip(alone, with_vehicle, strict=True):
        assert other.tracks.ids.max() < VEHICLE
        difference = one.prev_T_cur.mean.localCoordinates(other.prev_T_cur.mean)
        assert np.abs(difference).max() < 2e-3  # metres; measured 2e-4, as other chances look for the ground


def test_a_keyframe_that_is_found_again_knows_what_was_fixed(slow_flight):
    sequence = slow_flight.sequence
    odometry = VisualOdometry(sequence.camera, load_config(), sequence.ground, tracker=WithVehicle(60))
    another = texture(sequence.camera, 1)
    estimates = []
    for frame in slow_flight.frames[:20]:
        image = np.roll(another, 90 * frame.index, axis=1) if 10 <= frame.index < 14 else frame.image
        estimates.append(odometry.step(replace(frame, image=image)))
    assert estimates[14].status is Status.TRACKED and estimates[14].previous < 10  # found again
    known = [*estimates[:12], *estimates[14:]]  # while it is lost, hardly anything is followed but the vehicle
    assert not any((estimate.tracks.ids >= VEHICLE).any() for estimate in known)
