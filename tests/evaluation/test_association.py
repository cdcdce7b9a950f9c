import gtsam
import numpy as np
import pytest

from fvslam_graph.errors import ResultsError, TrajectoryError
from fvslam_graph.evaluation.association import associate, load_pair, load_trajectory
from fvslam_graph.trajectory import Trajectory


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
    with pytest.raises(TrajectoryError, match=r"absent\.txt cannot be read"):
        load_trajectory(tmp_path / "absent.txt")
    with pytest.raises(ResultsError, match="not the folder of a run"):
        load_trajectory(tmp_path)


@pytest.mark.parametrize("kitti", ["estimate", "reference", "both"])
def test_a_kitti_file_belongs_row_by_row_to_the_other(tmp_path, kitti: str) -> None:
    paths = {"estimate": tmp_path / "estimate", "reference": tmp_path / "reference"}
    for name, path in paths.items():
        (straight(TEN_HERTZ).write_kitti if kitti in (name, "both") else straight(TEN_HERTZ).write_tum)(path)
    estimate, reference = load_pair(**paths)
    assert np.array_equal(estimate.stamps, reference.stamps)
    assert np.allclose(estimate.stamps, np.arange(20) if kitti == "both" else TEN_HERTZ)

    straight(TEN_HERTZ[:-1]).write_kitti(paths["reference" if kitti == "both" else kitti])
    with pytest.raises(TrajectoryError, match=r"has no stamps, so .* equally many poses"):
        load_pair(**paths)
