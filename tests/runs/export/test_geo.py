"""Maps: where they are on Earth, and what readers of XML and JSON find in them."""

import json
from dataclasses import replace
from datetime import datetime
from xml.etree import ElementTree

import gtsam
import numpy as np
import pymap3d
import pytest

import fvslam_graph
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.runs.export.geo import GPX, KML
from fvslam_graph.runs.export.georeference import Georeference
from fvslam_graph.runs.export.poses import ExportedPoses
from fvslam_graph.runs.gnss_file import read_fixes, write_fixes
from fvslam_graph.sequences.open import open_sequence

ORIGIN = (48.2, 11.5, 520.0)
TO_ENU = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.4, -1.2, 2.0), np.array([30.0, -20, 5]))
SCALE = 2.5


def read_kml(path):
    text = ElementTree.parse(path).find(f".//{{{KML}}}coordinates").text
    return np.array([[float(number) for number in point.split(",")] for point in text.split()])


def read_gpx(path):
    points = ElementTree.parse(path).findall(f"{{{GPX}}}trk/{{{GPX}}}trkseg/{{{GPX}}}trkpt")
    return np.array([[float(p.get("lon")), float(p.get("lat")), float(p.find(f"{{{GPX}}}ele").text)] for p in points])


def read_geojson(path):
    line, *points = json.loads(path.read_text())["features"]
    coordinates = [point["geometry"]["coordinates"] for point in points]
    assert line["geometry"] == {"type": "LineString", "coordinates": coordinates}
    return np.array(coordinates)


@pytest.fixture
def fixes(run, tmp_path):
    """A file of fixes of the run, without noise, and where they are in east, north, up."""
    enu = SCALE * TO_ENU.transformFrom(run.online.positions.T).T
    places = np.column_stack(pymap3d.enu2geodetic(*enu.T, *ORIGIN))
    path = tmp_path / "fixes.csv"
    rows = [
        f"{stamp:.9f},{','.join(f'{number:.17g}' for number in place)}"
        for stamp, place in zip(run.online.stamps, places, strict=True)
    ]
    path.write_text("\n".join(["stamp,latitude,longitude,altitude", *rows, "1403636579.76,,,"]) + "\n")
    return path, places


@pytest.mark.parametrize(("format", "read"), [("kml", read_kml), ("gpx", read_gpx), ("geojson", read_geojson)])
def test_a_map_by_fixes(run, fixes, tmp_path, format, read):
    path, places = fixes
    done = fvslam_graph.export(run, format, tmp_path / "out" / f"flight.{format}", gnss=path)
    found = read(done.path)[:, [1, 0, 2]]
    assert np.abs(found[:, :2] - places[:, :2]).max() < 1e-9  # degrees, a tenth of a millimetre
    assert np.abs(found[:, 2] - places[:, 2]).max() < 1e-4
    assert done.notes == ("aligned with 8 fixes of fixes.csv, 0.00 m RMS apart, by a scale of 2.5000",)


def test_fixes_of_the_recording_are_kept_with_the_run(run, fixes, tmp_path):
    path, places = fixes
    fixes = read_fixes(path)
    assert np.array_equal(fixes.values, places) and len(fixes) == 8
    write_fixes(tmp_path / "again.csv", fixes)
    assert np.array_equal(read_fixes(tmp_path / "again.csv").values, places)
    done = fvslam_graph.export(replace(run, gnss=fixes), "kml", tmp_path / "map.kml")
    assert np.abs(read_kml(done.path)[:, :2] - places[:, [1, 0]]).max() < 1e-9
    assert "aligned with 8 fixes" in done.notes[0]
    done = fvslam_graph.export(replace(run, gnss=fixes), "kml", tmp_path / "origin.kml", origin=ORIGIN)
    assert "at the given origin" in done.notes[0]


def test_a_recording_with_gps_is_on_the_map(real_data, tmp_path):
    drive = real_data("kitti_raw") / "2011_09_26" / "2011_09_26_drive_0001_sync"
    run = fvslam_graph.run(open_sequence(drive, frames=":40"), out=tmp_path / "run")
    done = fvslam_graph.export(tmp_path / "run", "geojson", tmp_path / "map.geojson")
    found = read_geojson(done.path)
    truth = run.gnss.interpolate(run.online.stamps)
    enu = np.column_stack(pymap3d.geodetic2enu(*found[:, [1, 0, 2]].T, *truth[-1]))
    to_truth = np.column_stack(pymap3d.geodetic2enu(*truth.T, *truth[-1]))
    assert np.nanmax(np.linalg.norm(enu - to_truth, axis=1)) < 0.5  # m; measured 0.09


@pytest.mark.parametrize(("format", "read"), [("kml", read_kml), ("gpx", read_gpx), ("geojson", read_geojson)])
def test_files_lose_nothing(run, tmp_path, format, read):
    done = fvslam_graph.export(run, format, tmp_path / "map", origin=(*ORIGIN, 30))
    place = Georeference.by_origin((*ORIGIN, 30), run.info["down"])
    longitude, latitude, altitude = read(done.path).T
    enu = np.column_stack(pymap3d.geodetic2enu(latitude, longitude, altitude, *ORIGIN))
    assert np.abs(enu - place.enu(run.online.positions)).max() < 1e-8  # degrees have a resolution of a nanometre


@pytest.mark.parametrize(
    ("down", "forward", "up"),
    [
        ((0, 1, 0), (0, 0, 1), (0, -1, 0)),  # level
        (None, (0, 0, 1), (0, -1, 0)),
        ((0, 0, 1), (0, -1, 0), (0, 0, -1)),  # straight down
        ((0, 0, -1), (0, 1, 0), (0, 0, 1)),  # straight up
        ((0, 0.8, 0.6), (0, -0.6, 0.8), (0, -0.8, -0.6)),
        ((0, 0.6, 0.8), (0, -0.8, 0.6), (0, -0.6, -0.8)),
        ((0, 0.6, -0.8), (0, 0.8, 0.6), (0, -0.6, 0.8)),
    ],
)
@pytest.mark.parametrize(("heading", "east", "north"), [(0, 0, 1), (90, 1, 0), (225, -(0.5**0.5), -(0.5**0.5))])
def test_the_heading_is_where_the_camera_looks(down, forward, up, heading, east, north):
    place = Georeference.by_origin((*ORIGIN, heading), down)
    right = np.cross(forward, up)
    found = place.enu(np.array([(0, 0, 0), forward, right, up], float))
    assert np.allclose(found, [(0, 0, 0), (east, north, 0), (north, -east, 0), (0, 0, 1)], rtol=0, atol=1e-12)
    assert ("taken to be level" in place.note) == (down is None)


def test_covariances_of_positions_are_east_north_up(run, tmp_path):
    """A level camera that heads east: along its axis is east, to its right is south."""
    covariances = np.tile(np.diag([0, 0, 0, 1.0, 4.0, 9.0]), (8, 1, 1))  # right, down, forward
    still = Trajectory(run.online.stamps, tuple(gtsam.Pose3() for _ in range(8)))
    sure = replace(run, online=still, pose_covariances=covariances)
    path = fvslam_graph.export(sure, "geojson", tmp_path / "map.geojson", origin=(*ORIGIN, 90)).path
    _, *points = json.loads(path.read_text())["features"]
    for n, point in enumerate(points):
        facts = point["properties"]
        assert np.allclose(facts["covariance_enu"], np.diag([9, 1, 4]), rtol=0, atol=1e-12)
        assert (facts["frame"], facts["status"]) == (n, run.frames["status"][n])
        assert datetime.fromisoformat(facts["time"]).timestamp() == pytest.approx(facts["stamp"], abs=1e-6)


def test_times_are_of_recordings_that_have_the_date(run, tmp_path):
    early = replace(run, online=Trajectory(np.arange(8.0), run.online.poses), pose_covariances=None)
    path = fvslam_graph.export(early, "gpx", tmp_path / "map.gpx", origin=ORIGIN).path
    assert "<time>" not in path.read_text()
    path = fvslam_graph.export(early, "geojson", tmp_path / "map.geojson", origin=ORIGIN).path
    facts = json.loads(path.read_text())["features"][1]["properties"]
    assert facts["time"] is None and facts["covariance_enu"] is None
    path = fvslam_graph.export(run, "gpx", tmp_path / "dated.gpx", origin=ORIGIN).path
    assert "<time>2014-06-24T19:02:59.750000+00:00</time>" in path.read_text()


def test_a_name_that_xml_has_to_escape(run, tmp_path):
    for format in ("kml", "gpx"):
        path = fvslam_graph.export(replace(run, name="a<b>&\x01"), format, tmp_path / format, origin=ORIGIN).path
        assert "a<b>&\\x01" in list(ElementTree.parse(path).getroot().itertext())


def test_a_relative_scale_is_said(run, tmp_path):
    relative = replace(run, info=run.info | {"scale_source": "map"})
    done = fvslam_graph.export(relative, "kml", tmp_path / "map.kml", origin=ORIGIN)
    assert "distances on the map are not metres" in done.notes[-1]


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("time,latitude,longitude,altitude\n", "has no column stamp"),
        ("stamp,latitude,longitude,altitude\n1,2,x,3\n", "line 2 is not a row of numbers: 1,2,x,3"),
        ("stamp,latitude,longitude,altitude\n1,91,2,3\n", "line 2 is no place on Earth"),
        ("stamp,latitude,longitude,altitude\n1,nan,2,3\n", "line 2 is no place on Earth"),
        ("stamp,latitude,longitude,altitude\n1,2,3,4\n", "has 0 fixes while the run has poses"),
        (None, "fixes.csv is missing"),
    ],
)
def test_fixes_that_are_none(run, tmp_path, content, complaint):
    path = tmp_path / "fixes.csv"
    if content is not None:
        path.write_text(content)
    with pytest.raises(FvslamError, match=complaint):
        fvslam_graph.export(run, "kml", tmp_path / "map.kml", gnss=path)
    assert not (tmp_path / "map.kml").exists()


def test_fixes_of_a_receiver_that_stands(run, fixes, tmp_path):
    path, _ = fixes
    lines = path.read_text().splitlines()
    place = lines[1].split(",", 1)[1]
    path.write_text("\n".join([lines[0], *(f"{line.split(',')[0]},{place}" for line in lines[1:])]))
    with pytest.raises(FvslamError, match="are all within 1 m"):
        fvslam_graph.export(run, "kml", tmp_path / "map.kml", gnss=path)


def test_a_straight_path_may_be_turned_about_itself(run, fixes, tmp_path):
    path, places = fixes
    ahead = Trajectory(
        run.online.stamps, tuple(gtsam.Pose3(gtsam.Rot3(), np.array([0, 0, 5.0 * n])) for n in range(len(places)))
    )
    enu = np.outer(5.0 * np.arange(len(places)), [0.6, 0.8, 0])
    there = replace(read_fixes(path), values=np.column_stack(pymap3d.enu2geodetic(*enu.T, *ORIGIN)))
    done = fvslam_graph.export(replace(run, online=ahead, gnss=there), "gpx", tmp_path / "map.gpx")
    assert "do not tell how it is turned about itself" in done.notes[0]
    longitude, latitude, altitude = read_gpx(done.path).T
    assert np.abs(np.column_stack(pymap3d.geodetic2enu(latitude, longitude, altitude, *ORIGIN)) - enu).max() < 1e-4


@pytest.mark.parametrize("origin", [(1, 2), (91, 0, 0), (0, 181, 0), (0, 0, np.nan), (0, 0, 0, 0, 0)])
def test_an_origin_that_is_none(run, tmp_path, origin):
    with pytest.raises(FvslamError, match="the origin is LAT,LON,ALT"):
        fvslam_graph.export(run, "kml", tmp_path / "map.kml", origin=origin)


def test_the_place_of_poses_is_that_of_the_first(run):
    place = Georeference.by_origin(ORIGIN, None)
    poses = ExportedPoses.of(run, smoothed=False)
    assert np.allclose(place.geodetic(poses.trajectory.positions)[0], ORIGIN, rtol=0, atol=1e-8)
