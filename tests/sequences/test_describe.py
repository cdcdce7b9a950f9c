from fvslam_graph.sequences.describe import describe
from fvslam_graph.sequences.open import open_sequence


def test_a_full_recording(plain_folder):
    (plain_folder / "groundtruth.tum").write_text("0 0 0 0 0 0 0 1\n0.45 0 0 5 0 0 0 1\n")
    assert describe(open_sequence(plain_folder)) == [
        ("name", "flight"),
        ("format", "folder"),
        ("frames", "10 in 0.9 s, 10.0 Hz"),
        ("images", "64x48 pixels, gray, rectified"),
        ("camera", "fx 50.00, fy 51.00, cx 31.50, cy 23.50 pixels"),
        ("ground truth", "2 poses, 5.0 m, covers 50% of the frames"),
        (
            "scale",
            "camera 0.50 to 4.50 m +- 0.50 m above ground (times.csv height_m); "
            "ground normal (0.000, 1.000, 0.000), sigma 17.2 deg",
        ),
        ("gaps", "none"),
    ]


def test_gaps_notes_and_what_is_unknown(plain_folder):
    stamps = [0, 0.1, 0.2, 0.5, 0.6, 0.7, 2.7, 2.8, 2.9, 3.0]
    rows = [f"{number}.png,{stamp}\n" for number, stamp in enumerate(stamps)]
    (plain_folder / "times.csv").write_text("filename,timestamp_s\n" + "".join(rows))
    (plain_folder / "images" / "4.png").unlink()
    facts = dict(describe(open_sequence(plain_folder)))
    assert facts["gaps"] == "2: 0.30 s after frame 2, 2.00 s after frame 5"
    assert facts["note"] == "1 image is missing: frame 4"
    assert facts["ground truth"] == "none"
    assert facts["scale"] == "unknown: no height above ground"


def test_many_gaps_are_counted(plain_folder):
    stamps = [0, 1, 2, 5, 8, 11, 14, 17, 20, 23]
    rows = [f"{number}.png,{stamp}\n" for number, stamp in enumerate(stamps)]
    (plain_folder / "times.csv").write_text("filename,timestamp_s\n" + "".join(rows))
    assert dict(describe(open_sequence(plain_folder)))["gaps"] == "none"  # three seconds are the rule here
    assert dict(describe(open_sequence(plain_folder, frames="0:1")))["frames"] == "1"


def test_a_steady_height_and_heights_out_of_the_slice(plain_folder):
    facts = dict(describe(open_sequence(plain_folder, camera_height=1.5)))
    assert facts["scale"].startswith("camera 1.50 m +- 2% above ground (given)")
    (plain_folder / "times.csv").write_text("filename,timestamp_s,height_m\n0.png,0,\n1.png,1,1.5\n")
    facts = dict(describe(open_sequence(plain_folder, frames=":1")))
    assert facts["scale"] == "no height above ground in these frames (times.csv height_m)"
    assert facts["gaps"] == "none"
