import numpy as np
import pytest

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.sequences.oxts import EARTH_RADIUS, mercator, packet_poses, read_timestamps, seconds_since


def test_mercator_keeps_distances_near_the_start():
    metres = np.degrees(100 / EARTH_RADIUS)
    latitude, longitude = np.array([60.0, 60 + metres, 60.0]), np.array([10.0, 10.0, 10 + 2 * metres])
    east_north = mercator(latitude, longitude)
    # cos 60 deg = 1/2, so twice the longitude makes 100 m
    np.testing.assert_allclose(east_north[1:] - east_north[0], [[0, 100], [100, 0]], atol=5e-3)


def test_attitude_of_the_unit():
    # Heading north, nose down by 0.2: forward is north and down, left is west.
    pose = packet_poses(np.array([[49.0, 8.4, 100.0, 0.0, 0.2, np.pi / 2]]))[0]
    forward, left, _ = pose.rotation().matrix().T
    np.testing.assert_allclose(forward, [0, np.cos(0.2), -np.sin(0.2)], atol=1e-12)
    np.testing.assert_allclose(left, [-1, 0, 0], atol=1e-12)
    assert pose.z() == 100


def test_timestamps_keep_their_nanoseconds_across_midnight(tmp_path):
    path = tmp_path / "timestamps.txt"
    path.write_text("2011-09-26 23:59:59.999999999\n\n2011-09-27 00:00:00.000000001\n\n")
    stamps = read_timestamps(path)
    np.testing.assert_allclose(seconds_since(stamps[0], stamps), [0, np.nan, 2e-9], rtol=1e-12)


def test_missing_and_binary_timestamps(tmp_path):
    with pytest.raises(SequenceError, match=r"timestamps\.txt is missing"):
        read_timestamps(tmp_path / "timestamps.txt")
    (tmp_path / "timestamps.txt").write_bytes(b"\xff\xfe")
    with pytest.raises(SequenceError, match=r"timestamps\.txt cannot be read as text"):
        read_timestamps(tmp_path / "timestamps.txt")


@pytest.mark.parametrize("line", ["now", "2011-09-26", "2011-09-26 13:02:25Z", "2011-13-26 13:02:25"])
def test_lines_that_are_no_time(tmp_path, line):
    path = tmp_path / "timestamps.txt"
    path.write_text(f"2011-09-26 13:02:25.5\n{line}\n")
    with pytest.raises(SequenceError, match=r"timestamps\.txt: "):
        read_timestamps(path)
