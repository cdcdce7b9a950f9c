"""All formats from the command line: where they go, what is refused, and that nothing is written over."""

import re
import sys

import pytest

import fvslam_graph
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.runs.export.formats import FOLDERS, MAP_WRITERS, WRITERS


def test_beside_the_run_and_never_over_anything(fvslam, graph_run):
    folder = graph_run.folder.parent
    for format in (*WRITERS, *MAP_WRITERS):
        place = ("--origin", "48.2,11.5,520,90") if format in MAP_WRITERS else ()
        name = f"graph-smoothed-{format}" if format in FOLDERS else f"graph-smoothed.{format}"
        code, out, err = fvslam("export", graph_run.folder, "--to", format, "--smoothed", *place)
        assert (code, out) == (0, f"{folder / name}\n") and "fvslam:" not in err
        before = sorted(path.stat().st_mtime_ns for path in (folder / name).rglob("*"))
        code, out, err = fvslam("export", graph_run.folder, "--to", format, "--smoothed", *place)
        assert (code, out) == (1, "") and "exists and is not written over" in err
        assert sorted(path.stat().st_mtime_ns for path in (folder / name).rglob("*")) == before
    assert not list(folder.glob("writing_*"))


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ("--to tum", "there is no format 'tum'; it is one of csv, ros2, euroc, colmap, g2o, kml, gpx, geojson"),
        (
            "--to kml",
            r"nothing tells where on Earth graph is; --origin LAT,LON,ALT\[,HEADING\] places its first camera",
        ),
        ("--to csv --origin 1,2,3", r"place a map \(kml, gpx, geojson\); csv has no place"),
        ("--to kml --origin here", "--origin takes LAT,LON,ALT"),
        ("--to kml --origin 1,2,3 --gnss fixes.csv", "cannot both place a map"),
        ("--to csv --out /dev/null", "/dev/null exists and is not written over"),
        ("--to csv --out /dev/null/x.csv", "/dev/null"),
    ],
)
def test_what_is_refused(fvslam, graph_run, tmp_path, monkeypatch, options, complaint):
    monkeypatch.chdir(tmp_path)
    before = sorted(graph_run.folder.parent.iterdir())
    code, out, err = fvslam("export", graph_run.folder, *options.split())
    assert (code, out) == (1, "") and err.startswith("fvslam: ") and err.count("\n") == 1
    assert re.search(complaint, err), err
    assert sorted(graph_run.folder.parent.iterdir()) == before


def test_what_a_run_does_not_have(run, tmp_path, fvslam):
    with pytest.raises(FvslamError, match="flight has no smoothed poses"):
        fvslam_graph.export(run, "csv", tmp_path / "poses.csv", smoothed=True)
    code, out, err = fvslam("export", tmp_path, "--to", "csv")
    assert (code, out) == (1, "") and "is not the folder of a run" in err


@pytest.mark.parametrize(("format", "library", "extra"), [("ros2", "rosbags", "bags"), ("kml", "pymap3d", "geo")])
def test_a_library_that_is_not_installed(run, tmp_path, monkeypatch, format, library, extra):
    monkeypatch.setitem(sys.modules, library, None)
    origin = (48, 11, 500) if format == "kml" else None
    with pytest.raises(FvslamError, match=rf"{library} is not installed; `pip install fvslam-graph\[{extra}\]`"):
        fvslam_graph.export(run, format, tmp_path / "out", origin=origin)
    assert not list(tmp_path.iterdir())
