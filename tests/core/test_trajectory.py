"""Stamped poses and the files that hold them."""

import os

import gtsam
import numpy as np
import pytest

from fvslam_graph.core.errors import TrajectoryError
from fvslam_graph.core.trajectory import Trajectory, interpolate

POSE = gtsam.Pose3(gtsam.Rot3.Ypr(0.3, -0.2, 1.1), np.array([1.0, -2.0, 3.0]))
LINE = "{stamp} 1 2 3 0 0 0 1\n"


def some_trajectory(count: int = 50, seed: int = 0) -> Trajectory:
    """Poses all over SO(3), some kilometres from the origin, stamped as a recording of today."""
    rng = np.random.default_rng(seed)
    rotations = [gtsam.Rot3.Expmap(turn) for turn in rng.uniform(-np.pi, np.pi, (count, 3))]
    positions = rng.uniform(-3000, 3000, (count, 3))
    stamps = 1_403_715_273.262142976 + 0.05 * np.arange(count)
    return Trajectory(stamps, tuple(map(gtsam.Pose3, rotations, positions)))


def straight(stamps) -> Trajectory:
    """One metre a second along x, turning by 0.2 rad a second about z."""
    stamps = np.array(stamps, float)
    return Trajectory(stamps, tuple(gtsam.Pose3(gtsam.Rot3.Rz(0.2 * t), np.array([t, 0.0, 0.0])) for t in stamps))


def test_tum_files_keep_everything(tmp_path):
    written = some_trajectory()
    written.write_tum(tmp_path / "t.tum")
    read = Trajectory.read_tum(tmp_path / "t.tum")
    assert read.stamps == pytest.approx(written.stamps, rel=0, abs=1e-9)
    assert read.matrices == pytest.approx(written.matrices, rel=1e-12, abs=1e-12)


def test_kitti_files_keep_everything(tmp_path):
    written = some_trajectory()
    written.write_kitti(tmp_path / "t.txt")
    read = Trajectory.read_kitti(tmp_path / "t.txt", written.stamps)
    assert read.matrices == pytest.approx(written.matrices, rel=1e-12, abs=1e-12)
    assert np.array_equal(read.stamps, written.stamps)
    assert Trajectory.read_kitti(tmp_path / "t.txt").stamps.tolist() == list(range(50))


def test_tum_lines_by_hand(tmp_path):
    # A quarter turn about z: x points where y was.
    path = tmp_path / "t.tum"
    path.write_text(f"# stamp tx ty tz qx qy qz qw\n\n0.5 1 2 3 0 0 {0.5**0.5} {0.5**0.5}\n1.5, 4, 5, 6, 0, 0, 0, 1\n")
    read = Trajectory.read_tum(path)
    assert read.stamps.tolist() == [0.5, 1.5]
    assert read.matrices[0] == pytest.approx(np.array([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]))
    assert read.positions[1].tolist() == [4, 5, 6]


def test_kitti_lines_by_hand(tmp_path):
    (tmp_path / "t.txt").write_text("0 -1 0 1 1 0 0 2 0 0 1 3\n")
    read = Trajectory.read_kitti(tmp_path / "t.txt")
    assert read.poses[0].equals(gtsam.Pose3(gtsam.Rot3.Rz(np.pi / 2), np.array([1.0, 2.0, 3.0])), 1e-12)


def test_rotations_that_were_rounded_are_brought_back(tmp_path):
    (tmp_path / "t.txt").write_text(" ".join(f"{number:.3f}" for number in POSE.matrix()[:3].ravel()))
    R = Trajectory.read_kitti(tmp_path / "t.txt").matrices[0, :3, :3]
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14
    assert 1e-6 < np.abs(R - POSE.rotation().matrix()).max() < 1e-3


def test_evo_reads_what_is_written(tmp_path):
    from evo.tools.file_interface import read_kitti_poses_file, read_tum_trajectory_file

    written = some_trajectory()
    written.write_tum(tmp_path / "t.tum")
    written.write_kitti(tmp_path / "t.txt")
    for read in (read_tum_trajectory_file(tmp_path / "t.tum"), read_kitti_poses_file(tmp_path / "t.txt")):
        assert np.array(read.poses_se3) == pytest.approx(written.matrices, rel=1e-12, abs=1e-12)
    assert np.array(written.to_evo().poses_se3) == pytest.approx(written.matrices, abs=1e-12)
    assert np.array_equal(written.to_evo().timestamps, written.stamps)


def test_a_line_that_its_writer_did_not_finish(tmp_path):
    path = tmp_path / "t.tum"
    path.write_text(LINE.format(stamp=0) + LINE.format(stamp=1) + "2 1 2 3 0 0 0 1")
    assert len(Trajectory.read_tum(path)) == 3
    assert len(Trajectory.read_tum(path, unfinished=True)) == 2
    path.write_text(LINE.format(stamp=0) + "1 1 2")
    assert len(Trajectory.read_tum(path, unfinished=True)) == 1


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "holds no poses"),
        ("stamp x y z\nfrom here on\n,,\n", "holds no poses"),
        ("# nothing but a comment\n\n", "holds no poses"),
        ("0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0\n", "pose 2 has 7 numbers instead of 8"),
        ("0 1 2 3 0 0 0 1\n1 1 2 three 0 0 0 1\n", "pose 2 is not a row of numbers: '1 1 2 three 0 0 0 1'"),
        ("0 1 2 3 0 0 0 1\n2 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n", "not later than the one before, at pose 3 of 3"),
        ("0 1 2 3 0 0 0 1\n0 1 2 3 0 0 0 1\n", "not later than the one before, at pose 2 of 2"),
        ("0 1 2 3 0 0 0 0.9\n", "a quaternion whose length is not 1, at pose 1 of 1"),
        ("0 1 2 3 0 0 0 9\n", "a quaternion whose length is not 1"),
        ("0 1 2 -1e300 0 0 0 1\n", "a pose with the number 1e+300, which is no place in metres"),
        ("0 1 2 nan 0 0 0 1\n1 inf 2 3 0 0 0 1\n", "each of the 2 poses has a number that is not finite"),
        ("0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n1e300 1 2 3 0 0 0 1\n", "the stamp 1e+300, which is no time in seconds"),
        ("0 1 2 3 0 0 0 1\x00\n", "holds NUL bytes"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", "has no stamps: a pose has 12 numbers"),
        ("# t qw qx qy qz x y z\n0 1 0 0 0 1 2 3\n", "puts the quaternion in columns 2 to 5"),
        ("0 1 2 3 0 0 0 1 9\n", "neither a TUM file (8 numbers a line) nor a KITTI file (12): it has 9"),
    ],
)
def test_damaged_tum_files(tmp_path, text, complaint):
    path = tmp_path / "bad.tum"
    path.write_text(text)
    with pytest.raises(TrajectoryError) as error:
        Trajectory.read_tum(path)
    assert str(error.value).startswith(str(path)) and complaint in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("row", "complaint"),
    [
        ("1 0 0 0 0 1 0 0 0 0 1", "pose 2 has 11 numbers instead of 12"),
        ("1e9 0 0 0 0 1 0 0 0 0 1 0", "without a proper rotation matrix, at pose 2 of 2"),
        ("0 0 0 0 0 0 0 0 0 0 0 0", "without a proper rotation matrix, at pose 2 of 2"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0", "without a proper rotation matrix, at pose 2 of 2"),
        ("1.1 0 0 0 0 1.1 0 0 0 0 1.1 0", "without a proper rotation matrix, at pose 2 of 2"),
    ],
)
def test_damaged_kitti_files(tmp_path, row, complaint):
    path = tmp_path / "bad.txt"
    path.write_text(f"1 0 0 0 0 1 0 0 0 0 1 0\n{row}\n")
    with pytest.raises(TrajectoryError) as error:
        Trajectory.read_kitti(path)
    assert str(error.value).startswith(str(path)) and complaint in str(error.value)


def test_kitti_files_of_another_length_than_the_sequence(tmp_path):
    some_trajectory(5).write_kitti(tmp_path / "t.txt")
    with pytest.raises(TrajectoryError, match=r"t\.txt has 5 poses, but the sequence has 6 frames"):
        Trajectory.read_kitti(tmp_path / "t.txt", np.arange(6.0))


def test_files_that_are_none(tmp_path):
    (tmp_path / "image.tum").write_bytes(b"\x89PNG\xff\xfe\x00")
    (tmp_path / "utf16.tum").write_text("0 1 2 3 0 0 0 1\n", encoding="utf-16")
    (tmp_path / "circle.tum").symlink_to("circle.tum")
    os.mkfifo(tmp_path / "pipe.tum")
    with (tmp_path / "huge.tum").open("wb") as file:
        file.truncate(3 * 10**9)  # takes no space
    for name, complaint in {
        "absent.tum": "is missing",
        ".": "is a folder",
        "pipe.tum": "is no regular file",
        "/dev/zero": "is no regular file",
        "circle.tum": "is missing|Symlink loop|symbolic links",
        "image.tum": "cannot be read as text",
        "utf16.tum": "cannot be read as text",
        "huge.tum": "has 3000 MB",
        300 * "x": "cannot be read as text: .*name too long",
        "\0": "is missing",
    }.items():
        with pytest.raises(TrajectoryError, match=complaint):
            Trajectory.read(tmp_path / name)


# A quarter turn about z at (1, 2, 3), then none; as TUM has it, x y z w.
QUARTER, NONE = f"0 0 {0.5**0.5} {0.5**0.5}", "0 0 0 1"
QUARTER_ASL, NONE_ASL = f"{0.5**0.5},0,0,{0.5**0.5}", "1,0,0,0"
EUROC = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"


@pytest.mark.parametrize(
    "text",
    [
        f"\ufeff0.5 1 2 3 {QUARTER}\n0.75 4 5 6 {NONE}\n",
        f"\ufeff# timestamp tx ty tz qx qy qz qw\r\n0.5 1 2 3 {QUARTER}\r\n0.75 4 5 6 {NONE}\r\n",
        f"stamp,x,y,z,qx,qy,qz,qw\n0.5,1,2,3,{QUARTER.replace(' ', ',')}\n\n0.75,4,5,6,0,0,0,1\n",
        f"# a note\n0.5\t1 2 3 {QUARTER} # another\n  # a third\n0.75 4 5 6 {NONE}",
        f"# time tx ty tz qx qy qz qw sigma\n0.5 1 2 3 {QUARTER} 9\n0.75 4 5 6 {NONE} nan\n",
        f"{EUROC}\n500000000,1,2,3,{QUARTER_ASL}\n750000000,4,5,6,{NONE_ASL}\n",
        f"{EUROC},v,v,v,b,b,b,a,a,a\n500000000,1,2,3,{QUARTER_ASL}{9 * ',0'}\n750000000,4,5,6,{NONE_ASL}{9 * ',0'}\n",
        f"t,x,y,z,qw,qx,qy,qz\n0.5,1,2,3,{QUARTER_ASL}\n0.75,4,5,6,{NONE_ASL}\n",
    ],
    ids=["BOM", "CRLF", "commas", "comments", "more", "TUM-VI", "EuRoC", "seconds"],
)
def test_layouts(tmp_path, text):
    path = tmp_path / "poses"
    path.write_text(text, newline="")
    read = Trajectory.read(path)
    assert read.notes == () and read.stamps.tolist() == [0.5, 0.75]
    assert read.matrices[0] == pytest.approx(np.array([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]))
    assert read.matrices[1] == pytest.approx(gtsam.Pose3(gtsam.Rot3(), np.array([4.0, 5.0, 6.0])).matrix())


def test_nanoseconds_without_a_header(tmp_path):
    """ORB-SLAM3 writes blanks and w last, VINS commas and w first."""
    path = tmp_path / "poses"
    first, second = 1_403_636_580_500_000_000, 1_403_636_580_750_000_000
    path.write_text(f"{first}.000000 1 2 3 {QUARTER}\n{second}.000000 4 5 6 {NONE}\n")
    orb = Trajectory.read(path)
    path.write_text(f"{first},1,2,3,{QUARTER_ASL},7,7,7,\n{second},4,5,6,{NONE_ASL},7,7,7,\n")
    vins = Trajectory.read(path)
    assert np.array_equal(orb.stamps, vins.stamps)
    assert orb.stamps == pytest.approx([1_403_636_580.5, 1_403_636_580.75], rel=0, abs=1e-6)
    assert np.allclose(orb.matrices, vins.matrices, atol=1e-15) and orb.positions[1].tolist() == [4, 5, 6]
    assert orb.notes == ("poses: the stamps are read as nanoseconds",)
    assert len(vins.notes) == 1 and "read as w x y z" in vins.notes[0]


def test_poses_of_a_lost_target_are_left_out(tmp_path):
    path = tmp_path / "poses"
    path.write_text(f"0 1 2 3 {NONE}\n1 nan nan nan {NONE}\nnan 1 2 3 {NONE}\n3 1 1e400 3 {NONE}\n4 1 2 4 {NONE}\n")
    read = Trajectory.read(path)
    assert read.stamps.tolist() == [0, 4] and read.positions[1].tolist() == [1, 2, 4]
    assert read.notes == ("poses: 3 of 5 poses have a number that is not finite and are left out",)
    assert read.between(0, 3).notes == read.from_origin().notes == read.notes

    path.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 nan 0 1 0 0 0 0 1 0\n1 0 0 7 0 1 0 0 0 0 1 0\n")
    read = Trajectory.read(path)
    assert (read.rows, read.stamps.tolist(), read.positions[:, 0].tolist()) == (3, [0, 2], [0, 7])
    known = Trajectory.read_kitti(path, np.array([5.0, 6.0, 8.0]))
    assert known.rows is None and known.stamps.tolist() == [5, 8] and known.notes == read.notes


def test_stamps_and_poses_must_fit():
    with pytest.raises(TrajectoryError, match="2 stamps do not fit 1 poses"):
        Trajectory(np.array([0.0, 1.0]), (gtsam.Pose3(),))


def test_interpolation_by_hand():
    matched = straight([0, 1, 2]).interpolate(np.array([0.0, 0.25, 1.0, 1.5, 2.0]), max_gap=1.0)
    assert matched.stamps.tolist() == [0, 0.25, 1, 1.5, 2]
    for stamp, pose in zip(matched.stamps, matched.poses, strict=True):
        assert pose.equals(gtsam.Pose3(gtsam.Rot3.Rz(0.2 * stamp), np.array([stamp, 0.0, 0.0])), 1e-12)


def test_position_is_on_the_straight_line_and_rotation_on_the_geodesic():
    a, b = gtsam.Pose3(), gtsam.Pose3(gtsam.Rot3.Rx(1.0), np.array([0.0, 4.0, 0.0]))
    assert interpolate(a, b, 0.75).equals(gtsam.Pose3(gtsam.Rot3.Rx(0.75), np.array([0.0, 3.0, 0.0])), 1e-12)
    assert interpolate(a, b, 0.0).equals(a, 1e-12) and interpolate(a, b, 1.0).equals(b, 1e-12)


def test_nothing_is_interpolated_over_gaps_or_beyond_the_ends():
    known = straight([0.0, 0.2, 0.4, 1.0, 1.2])
    asked = np.array([-0.1, 0.0, 0.3, 0.4, 0.7, 1.0, 1.1, 1.2, 1.3])
    assert known.interpolate(asked).stamps.tolist() == [0.0, 0.3, 0.4, 1.0, 1.1, 1.2]
    assert known.interpolate(asked, max_gap=0.7).stamps.tolist() == [0.0, 0.3, 0.4, 0.7, 1.0, 1.1, 1.2]
    assert len(known.interpolate(np.array([5.0]))) == 0


def test_parts():
    trajectory = straight([0.0, 0.1, 0.2, 0.3])
    assert trajectory.between(0.1, 0.2).stamps.tolist() == [0.1, 0.2]
    assert len(trajectory.between(5, 6)) == 0
    assert trajectory.path_length == pytest.approx(0.3)


def test_from_origin_keeps_the_motion():
    known = some_trajectory(5)
    moved = known.from_origin()
    assert moved.poses[0].equals(gtsam.Pose3(), 1e-12)
    assert moved.poses[1].between(moved.poses[4]).equals(known.poses[1].between(known.poses[4]), 1e-9)
    assert not moved.poses[4].equals(known.poses[4], 1.0)
    assert moved.path_length == pytest.approx(known.path_length)


def test_no_poses():
    nothing = Trajectory(np.empty(0), ())
    assert nothing.positions.shape == (0, 3) and nothing.path_length == 0
    assert len(nothing.from_origin()) == 0
    assert len(nothing.interpolate(np.array([1.0]))) == 0
