"""What drones write: every dialect of subtitles and flight records."""

import numpy as np
import pytest

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sensors import SensorKind
from fvslam_graph.sequences.flight_record import read_flight_record
from fvslam_graph.sequences.srt import read_srt

BRACKETS = (
    '<font size="28">FrameCnt: 1, DiffTime: 33ms\n2024-03-08 10:12:34.123\n'
    "[iso: 100] [shutter: 1/944.10] [fnum: 3.7] [focal_len: 24.00] [latitude: -37.920295] [longitude: 176.456417] "
    "[rel_alt: 62.370 abs_alt: 227.373] [gb_yaw: -142.5 gb_pitch: -28.7 gb_roll: 0.5] </font>"
)
OLDER_BRACKETS = "[iso : 100] [latitude : -37.920295] [longtitude : 176.456417] [altitude: 227.373]"
LINES = (
    "HOME(149.0251,-20.2532) 2017.08.05 14:11:51\nGPS(149.0251,-20.2533,16) BAROMETER:1.9\nISO:100 Shutter:60 Fnum:2.2"
)
METRES = "2023.08.07 20:10:01\nGPS(-41.3899,174.0177,12.5M) BAROMETER:97.7M"
WORDS = "F/2.8, SS 206.14, ISO 100, EV 0, GPS (-122.3699, 37.8166, 15), D 24.26m, H 6.00m, H.S 2.10m/s, V.S 0.00m/s"


def subtitles(*texts):
    return "".join(
        f"{number}\n00:00:0{number},500 --> 00:00:0{number},533\n{text}\n\n" for number, text in enumerate(texts, 1)
    )


@pytest.fixture
def srt(tmp_path):
    def read(text):
        path = tmp_path / "flight.SRT"
        path.write_text(text)
        return {series.kind: series for series in read_srt(path)}

    return read


@pytest.fixture
def record(tmp_path):
    def read(text):
        path = tmp_path / "flight.csv"
        path.write_text(text)
        return {series.kind: series for series in read_flight_record(path)}

    return read


@pytest.mark.parametrize(
    ("text", "height", "place", "gimbal"),
    [
        (BRACKETS, 62.37, (-37.920295, 176.456417, 227.373), (-142.5, -28.7, 0.5)),
        (BRACKETS.replace(" gb_pitch", "] [gb_pitch"), 62.37, (-37.920295, 176.456417, 227.373), (-142.5, -28.7, 0.5)),
        (OLDER_BRACKETS, None, (-37.920295, 176.456417, 227.373), None),
        (LINES, 1.9, None, None),  # without an altitude, it is no place
        (METRES, 97.7, (-41.3899, 174.0177, 12.5), None),
        (WORDS, 6.0, None, None),
    ],
)
def test_subtitles(srt, text, height, place, gimbal):
    known = srt(subtitles(text, text))
    assert all(series.stamps.tolist() == [1.5, 2.5] for series in known.values())
    assert (SensorKind.GNSS in known) == (place is not None)
    assert (SensorKind.HEIGHT in known) == (height is not None)
    assert (SensorKind.ATTITUDE in known) == (gimbal is not None)
    if place is not None:
        np.testing.assert_array_equal(known[SensorKind.GNSS].values[1], place)
    if height is not None:
        np.testing.assert_array_equal(known[SensorKind.HEIGHT].values, [[height], [height]])
    if gimbal is not None:
        np.testing.assert_allclose(known[SensorKind.ATTITUDE].values[0], np.radians(gimbal))


def test_no_fix_is_no_place_and_what_is_cut_off_is_left_out(srt):
    nowhere = "[latitude: 0.000000] [longitude: 0.000000] [rel_alt: 1.300 abs_alt: 20.0]"
    known = srt(subtitles(nowhere, BRACKETS, BRACKETS, BRACKETS)[:-180])
    np.testing.assert_allclose(known[SensorKind.GNSS].stamps, [2.5, 3.5])
    np.testing.assert_allclose(known[SensorKind.HEIGHT].stamps, [1.5, 2.5, 3.5])
    np.testing.assert_allclose(known[SensorKind.HEIGHT].sigmas, 61.07)  # the smallest step


def test_subtitles_of_a_film(srt):
    with pytest.raises(SequenceError, match=r"flight\.SRT has no heights, places or attitudes of a drone"):
        srt(subtitles("Good morning!", "H is a letter"))


def test_a_place_that_is_none(srt):
    with pytest.raises(SequenceError, match=r"flight\.SRT: 149\.025 is no latitude in degrees"):
        srt(subtitles(*[LINES.replace("GPS(149.0251,-20.2533", "GPS(-20.2533,149.0251")] * 2))


@pytest.mark.parametrize(("unit", "metres"), [("ft", 0.3048), ("m", 1.0)])
def test_flight_record_with_groups(record, unit, metres):
    known = record(
        "sep=,\n"
        f"CUSTOM.date [local],OSD.flyTime,OSD.flyTime [s],OSD.latitude,OSD.longitude,OSD.height [{unit}],"
        f"OSD.heightMax [{unit}],OSD.altitude [{unit}],GIMBAL.pitch,GIMBAL.roll,GIMBAL.yaw,GIMBAL.yaw [360]\n"
        "1/2/2024,0m 0s,0,47.1,8.2,0.3,0.3,1000,-90,0,170,170\n"
        "1/2/2024,0m 0.1s,0.1,47.1,8.2,,0.3,1000,-89.5,0,-170,190\n"
        "1/2/2024,0m 0.1s,0.1,47.1,8.2,9,9,1000,-89.5,0,-170,190\n"
        "1/2/2024,0m 0.2s,0.2,47.1,8.2,0.6,0.6,1000\n"
    )
    height, gimbal, place = (known[kind] for kind in (SensorKind.HEIGHT, SensorKind.ATTITUDE, SensorKind.GNSS))
    np.testing.assert_allclose(height.stamps, [0, 0.2])
    np.testing.assert_allclose(height.values[:, 0], [0.3 * metres, 0.6 * metres])
    np.testing.assert_allclose(height.sigmas, 0.3 * metres, atol=1e-6)
    np.testing.assert_allclose(gimbal.values, np.radians([[170, -90, 0], [-170, -89.5, 0]]))
    np.testing.assert_allclose(place.values[2], [47.1, 8.2, 1000 * metres])


@pytest.mark.parametrize(("unit", "metres"), [("feet", 0.3048), ("meters", 1.0)])
def test_flight_record_with_units_in_parentheses(record, unit, metres):
    known = record(
        f"time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff({unit}),"
        f"height_above_ground_at_drone_location({unit}),altitude_above_seaLevel({unit}), gimbal_heading(degrees),"
        "gimbal_pitch(degrees),gimbal_roll(degrees),message\n"
        "100,2024-01-02 10:00:00,47.1,8.2,12.5,20,500,10,-45,1,\n"
        '200,2024-01-02 10:00:00,47.2,8.3,13.5,20,501,11,-46,1,"Take-off, then"\n'
    )
    np.testing.assert_allclose(known[SensorKind.HEIGHT].stamps, [0.1, 0.2])
    np.testing.assert_allclose(known[SensorKind.HEIGHT].values[:, 0], [12.5 * metres, 13.5 * metres])
    np.testing.assert_allclose(known[SensorKind.GNSS].values[1], [47.2, 8.3, 501 * metres])
    np.testing.assert_allclose(known[SensorKind.ATTITUDE].values[0], np.radians([10, -45, 1]))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", r"is no flight record of a known layout: its first line should name the columns, such as 'OSD.flyTime"),
        ("stamp,height\n0,1\n", "is no flight record of a known layout"),
        ("OSD.flyTime [s],OSD.yaw\n0,1\n", "is no flight record of a known layout"),
        (
            "time(millisecond),height_above_takeoff(miles)\n0,1\n",
            r"'height_above_takeoff\(miles\)' has none of the units",
        ),
        (
            "OSD.flyTime [s],OSD.height\n0,1\n",
            "the column 'OSD.height' has none of the units 'm', 'meters', 'ft', 'feet'",
        ),
        ("OSD.flyTime [s],OSD.height [m]\n0,1\n1,high\n", "row 2 has 'high' where a number is expected"),
        ("OSD.flyTime [s],OSD.height [m]\n", "has no heights, places or attitudes of a drone"),
        ("OSD.flyTime [s],OSD.latitude,OSD.longitude\n0,1,2\n1,1,200\n", "200 is no longitude in degrees"),
    ],
)
def test_other_tables(record, text, complaint):
    with pytest.raises(SequenceError, match=complaint):
        record(text)
