"""Heights by an altimeter, at frames."""

from dataclasses import replace

import numpy as np
import pytest

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.sequences.altimeter import read_altimeter, with_altimeter
from fvslam_graph.sequences.ground import override_ground, with_ground_plane
from fvslam_graph.simulation.synthetic import synthetic_sequence


@pytest.fixture
def sequence():
    return synthetic_sequence("uav", frames=40)


def written(folder, stamps, heights, sigma=None):
    path = folder / "altimeter.csv"
    columns = [stamps, heights] if sigma is None else [stamps, heights, np.full(len(stamps), sigma)]
    rows = [",".join(f"{number:.6f}" for number in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join(["stamp,height" + ("" if sigma is None else ",sigma"), *rows]) + "\n")
    return path


def test_heights_of_another_rate_are_interpolated_without_outliers(tmp_path, sequence):
    stamps = np.arange(-1.0, 5.0, 1 / 7)
    heights = 20 + stamps
    wrong = heights.copy()
    wrong[[5, 17, 18, 30]] += [5, -8, 8, 300]
    found = with_altimeter(sequence, read_altimeter(written(tmp_path, stamps, wrong)))
    assert found.ground.heights == pytest.approx(20 + sequence.stamps, abs=1e-3)
    assert found.ground.source == "altimeter altimeter.csv"
    assert found.ground.normal == pytest.approx(sequence.ground.normal)


def test_the_deviation_is_that_of_the_file_or_that_of_the_readings(tmp_path, sequence):
    stamps = np.arange(-1.0, 4.0, 0.02)
    heights = 20 + 0.2 * np.random.default_rng(0).standard_normal(len(stamps))
    measured = with_altimeter(sequence, read_altimeter(written(tmp_path, stamps, heights))).ground.height_sigma
    assert measured == pytest.approx(0.2, rel=0.2)
    assert with_altimeter(
        sequence, read_altimeter(written(tmp_path, stamps, heights, 0.5))
    ).ground.height_sigma == pytest.approx(0.5)
    assert with_altimeter(sequence, read_altimeter(written(tmp_path, stamps, heights, 0.0))).ground.height_sigma > 0


def test_only_a_height_that_was_measured_once_is_wrong_in_all_frames(tmp_path, sequence):
    mounted = override_ground(sequence, 1.5, None)
    flown = with_altimeter(mounted, read_altimeter(written(tmp_path, np.arange(-1.0, 4.0, 0.1), np.full(50, 1.5))))
    planes = mounted, with_ground_plane(sequence, (0, 1, 0, 1.5)), flown, sequence
    assert [known.ground.common_sigma > 0 for known in planes] == [True, True, False, False]


def test_heights_in_gaps_are_unknown(tmp_path, sequence):
    stamps = np.concatenate([np.arange(0, 1, 0.1), np.arange(1.8, 3, 0.1)])
    heights = with_altimeter(sequence, read_altimeter(written(tmp_path, stamps, 0 * stamps + 9))).ground.heights
    within = (sequence.stamps > 0.9 + 1e-6) & (sequence.stamps < 1.8 - 1e-6)
    assert within.any() and np.isnan(heights[within]).all()
    outside = ~within & (sequence.stamps <= stamps[-1])
    assert heights[outside] == pytest.approx(9.0)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "first line stamp,height"),
        ("time,alt\n0,1\n", "first line stamp,height"),
        ("stamp,height\n0,1\n", "at least 2"),
        ("stamp,height\n0,1\nx,1\n", "row 2 is not numbers"),
        ("stamp,height\n0,1\n1,1,3\n", "row 2 has 3 values"),
        ("stamp,height,sigma\n0,1\n1,1\n", "rows have 2 values"),
        ("stamp,height\n1,1\n0,1\n", "altimeter.csv"),
        ("stamp,height\n0,-1\n1,-1\n2,-1\n", "not above zero"),
    ],
)
def test_what_is_wrong_with_a_file_is_one_sentence(tmp_path, text, complaint):
    path = tmp_path / "altimeter.csv"
    path.write_text(text)
    with pytest.raises(SequenceError, match=complaint):
        read_altimeter(path)


def test_an_altimeter_of_another_clock_is_refused(tmp_path, sequence):
    readings = read_altimeter(written(tmp_path, 1e9 + np.arange(5.0), np.full(5, 2.0)))
    with pytest.raises(SequenceError, match="of the same clock"):
        with_altimeter(sequence, readings)


def test_a_ground_plane_by_the_user(sequence):
    ground = with_ground_plane(replace(sequence, ground=None), [0, 2, 0, 1.5]).ground
    assert ground.normal == pytest.approx([0, 1, 0]) and (ground.heights == 1.5).all()
    for plane in ([0, 1, 0], [0, 0, 0, 1], [0, 1, 0, -1], [0, 1, 0, np.nan]):
        with pytest.raises(SequenceError, match="nx ny nz d"):
            with_ground_plane(sequence, plane)
