import gtsam
import numpy as np
import pytest

from fvslam_graph.core.errors import ResultsError, TrajectoryError
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation import association
from fvslam_graph.evaluation.association import TrajectoryPairs, associate, load_trajectory


def straight(stamps: np.ndarray) -> Trajectory:
    """10 m/s along z."""
    return Trajectory(stamps, tuple(gtsam.Pose3(gtsam.Rot3(), np.array([0, 0, 10 * stamp])) for stamp in stamps))


TEN_HERTZ = 0.1 * np.arange(20)


def test_equal_stamps_are_paired_also_where_poses_are_missing() -> None:
    reference = straight(TEN_HERTZ)
    pairs = associate(straight(TEN_HERTZ[[2, 3, 7, 19]]), reference)
    assert not pairs.interpolated
    assert pairs.indices.tolist() == [0, 1, 2, 3]
    assert np.array_equal(pairs.reference.stamps, TEN_HERTZ[[2, 3, 7, 19]])
    pairs = associate(reference, straight(TEN_HERTZ[[2, 3, 7]]))
    assert pairs.indices.tolist() == [2, 3, 7]


def test_stamps_that_differ_by_rounding_are_equal() -> None:
    pairs = associate(straight(TEN_HERTZ + 5e-4), straight(TEN_HERTZ))
    assert not pairs.interpolated
    assert len(pairs.indices) == 20


@pytest.mark.parametrize("rate", [4.0, 13.0, 100.0])
def test_a_reference_at_another_rate_is_interpolated(rate: float) -> None:
    reference = straight(np.arange(0.3 / rate, 2.5, 1 / rate))
    pairs = associate(straight(TEN_HERTZ), reference)
    assert pairs.interpolated
    assert 18 <= len(pairs.indices) <= 20  # no reference before its first pose
    assert np.array_equal(pairs.estimate.stamps, TEN_HERTZ[pairs.indices])
    assert np.abs(pairs.estimate.positions - pairs.reference.positions).max() < 1e-12


def test_no_time_in_common_is_one_sentence() -> None:
    with pytest.raises(TrajectoryError, match=r"0 of 20 poses .* 0\.000 to 1\.900 s, .* 1000\.000 to 1001\.900 s"):
        associate(straight(TEN_HERTZ), straight(TEN_HERTZ + 1000))
    with pytest.raises(TrajectoryError, match="without poses"):
        associate(Trajectory(np.empty(0), ()), straight(TEN_HERTZ))


def test_files_are_recognised(tmp_path, make_run) -> None:
    trajectory = straight(TEN_HERTZ)
    trajectory.write_tum(tmp_path / "a.txt")
    trajectory.write_kitti(tmp_path / "b.txt")
    assert np.allclose(load_trajectory(tmp_path / "a.txt").stamps, TEN_HERTZ)
    assert np.array_equal(load_trajectory(tmp_path / "b.txt").stamps, np.arange(20))
    assert len(load_trajectory(make_run(truth=trajectory))) == 20
    (tmp_path / "c.txt").write_text("# comment\n1 2 3\n")
    with pytest.raises(TrajectoryError, match=r"c\.txt is neither .* it has 3"):
        load_trajectory(tmp_path / "c.txt")
    with pytest.raises(TrajectoryError, match=r"absent\.txt is missing"):
        load_trajectory(tmp_path / "absent.txt")
    with pytest.raises(ResultsError, match="not the folder of a run"):
        load_trajectory(tmp_path)


@pytest.mark.parametrize("kitti", ["estimate", "reference", "both"])
def test_a_kitti_file_belongs_row_by_row_to_the_other(tmp_path, kitti: str) -> None:
    paths = {"estimate": tmp_path / "estimate", "reference": tmp_path / "reference"}

    def pair() -> TrajectoryPairs:
        return associate(load_trajectory(paths["estimate"]), load_trajectory(paths["reference"]))

    for name, path in paths.items():
        (straight(TEN_HERTZ).write_kitti if kitti in (name, "both") else straight(TEN_HERTZ).write_tum)(path)
    pairs = pair()
    assert pairs.indices.tolist() == list(range(20)) and not pairs.interpolated
    assert np.array_equal(pairs.estimate.stamps, pairs.reference.stamps)
    assert np.allclose(pairs.estimate.stamps, np.arange(20) if kitti == "both" else TEN_HERTZ)

    lost = paths["reference" if kitti == "both" else kitti]
    rows = lost.read_text().splitlines()
    lost.write_text("\n".join([*rows[:3], "nan " * 11 + "nan", *rows[4:]]))
    assert pair().indices.tolist() == (list(range(19)) if kitti == "estimate" else [0, 1, 2, *range(4, 20)])
    assert np.array_equal(pair().estimate.positions, pair().reference.positions)

    straight(TEN_HERTZ[:-1]).write_kitti(lost)
    with pytest.raises(TrajectoryError, match=r"has no stamps, so .* equally many poses, not (20 and 19|19 and 20)"):
        pair()


@pytest.mark.parametrize("early", [0.0, 1000.0])
def test_the_pairs_are_those_of_evo_where_the_reference_is_too_sparse_to_be_interpolated(early: float) -> None:
    from evo.core.sync import associate_trajectories

    estimate, reference = straight(0.1 * np.arange(100) - early), straight(np.arange(10) + 0.004)
    expected, _ = associate_trajectories(reference.to_evo(), estimate.to_evo(), max_diff=0.01, offset_2=early)
    pairs = associate(estimate, reference, early)
    assert not pairs.interpolated and pairs.indices.tolist() == list(range(0, 100, 10))
    assert np.allclose(pairs.reference.positions, expected.positions_xyz)
    assert np.array_equal(pairs.estimate.stamps, estimate.stamps[::10])  # of the estimate's own clock
    assert np.abs(pairs.estimate.stamps - pairs.reference.stamps).max() == pytest.approx(0.004)


def test_a_dense_reference_is_interpolated_after_the_offset() -> None:
    pairs = associate(straight(TEN_HERTZ), straight(np.arange(0, 3, 0.03) + 7), time_offset=7.0)
    assert pairs.interpolated and len(pairs.indices) == 20
    assert np.allclose(pairs.reference.positions[:, 2] - pairs.estimate.positions[:, 2], 70)


@pytest.mark.parametrize(
    ("stamps", "reason"),
    [
        (TEN_HERTZ * 1e9, r"stamps of the estimate seem to be nanoseconds: divide them by 1e9"),
        (1e12 + TEN_HERTZ * 1e3, r"stamps of the estimate seem to be milliseconds"),
        (1e6 + TEN_HERTZ / 1e3, r"stamps of the reference seem to be milliseconds"),
        (TEN_HERTZ + 500, r"--time-offset SECONDS.* added to the stamps of the estimate; 999999500\.000 if both begin"),
        (1e9 + np.array([0.3, 0.4, 0.6]), r"nearest stamps are 0\.3 s apart.* may be 0\.01 s, .* poses are 1 s apart"),
        (1e9 + np.array([0.5]), r"nearest stamps are 0\.5 s apart"),
    ],
)
def test_why_nothing_matches(stamps: np.ndarray, reason: str) -> None:
    times = {"nanoseconds": 1 + np.arange(3.0), "milliseconds": 1e9 + np.arange(3.0)}
    reference = straight(next((known for unit, known in times.items() if unit in reason), 1e9 + np.arange(3.0)))
    with pytest.raises(TrajectoryError, match=reason) as error:
        associate(straight(stamps), reference)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("offset", "complaint"), [(np.nan, "must be a number of seconds"), (1e300, "not later")])
def test_an_offset_that_is_none(offset: float, complaint: str) -> None:
    with pytest.raises(TrajectoryError, match=complaint):
        associate(straight(TEN_HERTZ), straight(TEN_HERTZ), offset)


def test_more_poses_than_can_be_compared(monkeypatch) -> None:
    monkeypatch.setattr(association, "MAX_POSES", 10)
    with pytest.raises(TrajectoryError, match="20 poses are too many to be compared; take every n-th, 10 at most"):
        associate(straight(TEN_HERTZ), straight(TEN_HERTZ))
