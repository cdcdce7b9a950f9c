"""A generated flight with a gimbal, written as a video, and what its drone would have recorded on another clock."""

import re
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.random_streams import stream
from fvslam_graph.core.sensors import SensorKind
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.simulation.worlds.motion import Motion, knots, wobble
from fvslam_graph.simulation.worlds.terrain import Terrain
from fvslam_graph.simulation.worlds.uav import uav_camera
from fvslam_graph.simulation.worlds.waves import Waves

SIZE, DURATION, RATE = (160, 120), 30, 10
FOV = np.degrees(2 * np.arctan(1 / 1.5))
LATE = 0.8  # seconds that the clock of the record is ahead of the video's
OFFSET = re.compile(r"(-?\d+\.\d+) s are added to the times of (\S+), by the motion in the images \(.* (\d\.\d+) s\)")


def fly(seed, slower=1.0):
    """A multirotor at 20 m that turns, climbs and changes its speed, all with periods as much longer."""
    rng = stream(seed, "flight of a drone")
    t = knots(DURATION)
    course = Waves.random(rng, (0.5, 13.0 * slower), (0.2, 6.0 * slower))(t)
    pace = 5 + Waves.random(rng, (1.0, 9.0 * slower), (0.5, 5.0 * slower))(t)
    climb = Waves.random(rng, (1.5, 11.0 * slower), (0.8, 6.0 * slower))
    path = CubicSpline(t, np.column_stack([pace * np.cos(course), pace * np.sin(course), climb(t, 1)])).antiderivative()
    path.c[-1] += (0.0, 0.0, 20 + climb(t[0]))
    return Motion(path, wobble(rng, (0.004, 0.9), (0.002, 0.37)), depression=np.pi / 2, leans=False)


class Flown(NamedTuple):
    """What a record holds at times (N,): metres, degrees."""

    time: np.ndarray
    height: np.ndarray
    latitude: np.ndarray
    longitude: np.ndarray
    yaw: np.ndarray


def flown(motion, times):
    east, north, height = motion.path(times).T
    forward = np.array([-motion.pose(time).rotation().matrix()[:, 1] for time in times])
    yaw = np.degrees(np.arctan2(forward[:, 0], forward[:, 1]))
    radius = 6_371_000
    latitude = 47 + np.degrees(north / radius)
    longitude = 8 + np.degrees(east / radius / np.cos(np.radians(47)))
    return Flown(times + LATE, height, latitude, longitude, yaw)


def subtitles(times, texts):
    def clock(time):
        return f"00:{int(time / 60):02d}:{int(time % 60):02d},{round(1000 * (time % 1)):03d}"

    step = times[1] - times[0]
    rows = enumerate(zip(times, texts, strict=True), 1)
    return "".join(f"{n}\n{clock(t)} --> {clock(t + step - 0.001)}\n{text}\n\n" for n, (t, text) in rows)


def brackets(motion):
    at = flown(motion, np.arange(0, DURATION, 1 / RATE))
    return subtitles(
        at.time,
        [
            f'<font size="28">FrameCnt: {n}, DiffTime: 100ms\n[iso: 100] [latitude: {lat:.6f}] [longitude: {lon:.6f}] '
            f"[rel_alt: {h:.1f}00 abs_alt: {h + 400:.3f}] [gb_yaw: {yaw:.1f} gb_pitch: -90.0 gb_roll: 0.0] </font>"
            for n, (_, h, lat, lon, yaw) in enumerate(zip(*at, strict=True))
        ],
    )


def lines(motion):
    at = flown(motion, np.arange(0, DURATION, 1.0))
    rows = zip(at.height, at.latitude, at.longitude, strict=True)
    texts = [f"HOME(8.0000,47.0000)\nGPS({lon:.4f},{lat:.4f},16) BAROMETER:{h:.1f}\nISO:100" for h, lat, lon in rows]
    return subtitles(at.time, texts)


def groups(motion, unit="ft", metres=0.3048):
    at = flown(motion, np.arange(-0.7, DURATION, 1 / RATE))
    header = f"OSD.flyTime,OSD.flyTime [s],OSD.latitude,OSD.longitude,OSD.height [{unit}],OSD.altitude [{unit}],"
    header += "GIMBAL.pitch,GIMBAL.roll,GIMBAL.yaw\n"
    return (
        "sep=,\n"
        + header
        + "".join(
            f"0m 0s,{t:.1f},{lat:.7f},{lon:.7f},{h / metres:.1f},{h / metres:.1f},-90,0,{yaw:.1f}\n"
            for t, h, lat, lon, yaw in zip(*at, strict=True)
        )
    )


def parentheses(motion):
    at = flown(motion, np.arange(-0.7, DURATION, 1 / RATE))
    header = "time(millisecond),latitude,longitude,height_above_takeoff(meters),"
    header += "altitude_above_seaLevel(meters),gimbal_heading(degrees),gimbal_pitch(degrees),gimbal_roll(degrees)\n"
    return header + "".join(
        f"{1000 * t:.0f},{lat:.7f},{lon:.7f},{h:.1f},{h + 400:.1f},{yaw % 360:.1f},-90.0,0.0\n"
        for t, h, lat, lon, yaw in zip(*at, strict=True)
    )


@pytest.fixture(scope="module")
def motion():
    return fly(0)


@pytest.fixture(scope="module")
def film(motion, tmp_path_factory):
    """The video."""
    path = tmp_path_factory.mktemp("film") / "flight.mp4"
    terrain, noise = Terrain(uav_camera(SIZE), 0), np.random.default_rng(0)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), RATE, SIZE)
    for time in np.arange(0, DURATION, 1 / RATE):
        image = terrain.render(motion.pose(time)) + noise.normal(0, 2, SIZE[::-1])
        writer.write(cv2.cvtColor(np.clip(image, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


@pytest.fixture
def video(film, tmp_path):
    """A link to it, beside which a test may put files."""
    path = tmp_path / "flight.mp4"
    path.symlink_to(film)
    return path


@pytest.mark.parametrize(
    ("name", "write", "resolution", "off"),
    [
        ("flight.SRT", brackets, 0.1, 0.1),  # metres; measured at most 0.06 off, most of it by the resolution
        ("flight.srt", lines, 0.1, 0.3),  # a row a second: measured 0.19
        ("flight.csv", groups, 0.03048, 0.06),  # measured 0.03
        ("flight.csv", parentheses, 0.1, 0.1),  # measured 0.06
    ],
)
def test_the_clock_of_the_record_is_found(video, motion, name, write, resolution, off):
    (video.parent / name).write_text(write(motion))
    sequence = open_sequence(video, fov=FOV)
    offset, file, sigma = OFFSET.fullmatch(sequence.notes[-1]).groups()
    assert file == name
    assert abs(float(offset) + LATE) < 0.05  # measured at most 0.02, over three flights
    assert 0.003 < float(sigma) < 0.04
    error = sequence.ground.heights - motion.path(sequence.stamps)[:, 2]
    known = np.isfinite(error)
    assert known.sum() > len(sequence) - 15 and np.abs(error[known]).max() < off
    assert sequence.ground.height_sigma == pytest.approx(resolution)
    assert sequence.ground.source == f"{name}, above the take-off"


def test_sensors_are_on_the_clock_of_the_video(video, motion):
    (video.parent / "flight.srt").write_text(brackets(motion))
    sequence = open_sequence(video, fov=FOV, telemetry_offset=-LATE)
    height, place, gimbal = sequence.sensors
    assert [series.kind for series in sequence.sensors] == [SensorKind.HEIGHT, SensorKind.GNSS, SensorKind.ATTITUDE]
    np.testing.assert_allclose(height.stamps, sequence.stamps, atol=0.001)
    np.testing.assert_allclose(height.values[:, 0], motion.path(height.stamps)[:, 2], atol=0.051)
    assert np.ptp(place.values[:, 0]) > 1e-5 and (height.source, place.source) == ("flight.srt", "flight.srt")
    np.testing.assert_allclose(gimbal.values[:, 1], -np.pi / 2)
    np.testing.assert_allclose(sequence.ground.normal, [0, 0, 1], atol=1e-12)  # straight down
    assert sequence.ground.normal_sigma == pytest.approx(0.05)
    assert open_sequence(video, fov=FOV, telemetry_offset=-LATE, frames="10:20").ground.heights[0] == pytest.approx(
        height.values[10, 0]
    )


@pytest.mark.parametrize("record", ["another flight", "nothing happens", "too short"])
def test_what_does_not_tell_is_not_taken(video, motion, record):
    text = brackets(fly(1, 1.4) if record == "another flight" else motion)
    if record == "nothing happens":
        text = re.sub(r"(rel_alt|latitude|longitude|gb_yaw): \S+?([\s\]])", r"\1: 20.0\2", text)
    if record == "too short":
        text = "\n\n".join(text.split("\n\n")[:40])
    (video.parent / "flight.srt").write_text(text)
    sequence = open_sequence(video, fov=FOV)
    assert sequence.notes[-1] == "the images do not tell clearly how far the clock of flight.srt is off: 0 s is taken"


def test_the_first_and_the_last_height_hold_for_a_moment(video, motion):
    (video.parent / "flight.srt").write_text(brackets(motion))
    for early in (-0.09, 0.09):
        heights = open_sequence(video, fov=FOV, telemetry_offset=early - LATE).ground.heights
        assert np.isfinite(heights).all()
    heights = open_sequence(video, fov=FOV, telemetry_offset=0.35 - LATE).ground.heights
    assert np.isnan(heights[:3]).all() and np.isfinite(heights[3:]).all()


def test_gaps_have_no_height(video, motion):
    cues = brackets(motion).split("\n\n")
    (video.parent / "flight.srt").write_text("\n\n".join(cues[:100] + cues[150:]))
    heights = open_sequence(video, fov=FOV, telemetry_offset=-LATE).ground.heights
    assert np.isnan(heights[100:150]).all() and np.isfinite(heights[:99]).all() and np.isfinite(heights[151:-2]).all()


def test_a_camera_that_moves_has_a_ground_that_is_less_certain(video, motion):
    cues = brackets(motion).split("\n\n")
    cues = [cue.replace("-90.0", f"{-30 - 20 * (n % 2)}.0") for n, cue in enumerate(cues)]
    (video.parent / "flight.srt").write_text("\n\n".join(cues))
    ground = open_sequence(video, fov=FOV, telemetry_offset=-LATE).ground
    assert ground.normal_sigma > np.radians(10)
    assert ground.normal[0] == 0 and 0.5 <= ground.normal[2] <= 0.77  # sines of 30 and 50 degrees


def test_below_the_take_off_no_height_is_known(video, motion):
    text = re.sub(r"rel_alt: ", "rel_alt: -", brackets(motion))
    (video.parent / "flight.srt").write_text(text)
    sequence = open_sequence(video, fov=FOV, telemetry_offset=-LATE)
    assert np.isnan(sequence.ground.heights).all()
    assert sequence.notes[-1] == "flight.srt knows no height above the take-off while the camera records"


def test_heights_of_times_csv_stand_but_for_a_record_that_is_given(video, motion):
    rows = "".join(f"{n / RATE},7.{n % 10}\n" for n in range(DURATION * RATE))
    (video.parent / "times.csv").write_text("timestamp_s,height_m\n" + rows)
    srt = video.parent / "flight.srt"
    srt.write_text(brackets(motion))
    beside = open_sequence(video, fov=FOV, telemetry_offset=-LATE)
    assert beside.ground.source == "times.csv height_m" and beside.ground.normal[2] == pytest.approx(1)
    given = open_sequence(video, fov=FOV, telemetry=srt, telemetry_offset=-LATE)
    assert given.ground.source == "flight.srt, above the take-off"


def test_what_is_no_telemetry(video, motion):
    film = video.parent / "flight.srt"
    film.write_text("1\n00:00:00,000 --> 00:00:02,000\nGood morning!\n")
    sequence = open_sequence(video, fov=FOV)
    assert sequence.sensors == () and re.match(r"not used: .*flight\.srt has no heights", sequence.notes[-1])
    with pytest.raises(SequenceError, match=r"flight\.srt has no heights, places or attitudes of a drone"):
        open_sequence(video, fov=FOV, telemetry=film)
    with pytest.raises(SequenceError, match=r"flight\.mp4 is no telemetry: subtitles \(\.srt\) and flight records"):
        open_sequence(video, fov=FOV, telemetry=video)
    with pytest.raises(SequenceError, match="the offset of the telemetry must be a number of seconds, not inf"):
        open_sequence(video, fov=FOV, telemetry_offset=np.inf)
    film.unlink()
    with pytest.raises(SequenceError, match=r"flight\.mp4 has no telemetry beside it whose clock could be off"):
        open_sequence(video, fov=FOV, telemetry_offset=1)
    with pytest.raises(SequenceError, match="no telemetry of synthetic:uav is given, whose clock could be off"):
        open_sequence("synthetic:uav", telemetry_offset=1)


def test_of_any_recording(plain_folder: Path):
    srt = plain_folder / "flight.srt"
    texts = [f"[rel_alt: {n}.0 abs_alt: 0.0]" for n in range(10)]
    srt.write_text(subtitles(np.arange(10.0), texts))
    sequence = open_sequence(plain_folder, telemetry=srt, telemetry_offset=-5)
    np.testing.assert_allclose(sequence.ground.heights, 5 + 0.1 * np.arange(10))
