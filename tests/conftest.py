"""What several tests share."""

import functools
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from fvslam_graph.cli import main
from fvslam_graph.simulation import synthetic
from fvslam_graph.simulation.synthetic import synthetic_sequence

from .drawn import drawn  # noqa: F401

pytest_plugins = ["fvslam_graph.testing"]

ROOT = Path(__file__).parents[1]

if "PYTEST_XDIST_WORKER" in os.environ:  # there are as many of these as cores
    cv2.setNumThreads(1)
    threadpool_limits(1)


build = synthetic._build


@functools.lru_cache(6)
def built_once(options: object) -> object:
    """A synthetic world that keeps what it renders: many tests look at the same few frames."""
    world = build(options)
    world.render = functools.lru_cache(48)(world.render)
    return world


synthetic._build = functools.update_wrapper(built_once, build)


@pytest.fixture(scope="session")
def real_data() -> Callable[[str], Path]:
    """The folder of a real recording, by its name below FVSLAM_DATA; skips the test where it is absent."""

    def find(name: str) -> Path:
        path = Path(os.environ.get("FVSLAM_DATA", ROOT.parent / "shared" / "data")) / name
        if not path.exists():
            pytest.skip(f"real sequence {name} is not at {path}; set FVSLAM_DATA to its folder")
        return path

    return find


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plain folder to read or copy: 12 rendered images of a road between facades, with heights and ground truth."""
    folder = tmp_path_factory.mktemp("recordings") / "drive"
    (folder / "images").mkdir(parents=True)
    sequence = synthetic_sequence("drive", frames=12, size="320x100")
    times = ["filename,timestamp_s,height_m"]
    for frame in sequence:
        name = f"{frame.index:02d}.png"
        assert cv2.imwrite(str(folder / "images" / name), frame.image)
        times.append(f"{name},{frame.stamp:.3f},{frame.height:.3f}")
    (folder / "times.csv").write_text("\n".join(times) + "\n")
    camera = sequence.camera
    (folder / "camera.yaml").write_text(
        f"image_width: {camera.width}\nimage_height: {camera.height}\ncamera_matrix: {camera.K.ravel().tolist()}\n"
    )
    sequence.ground_truth.write_tum(folder / "groundtruth.tum")
    return folder


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures become files with nothing to see: for tests of what is around them, since drawing takes seconds."""
    from matplotlib.figure import Figure

    monkeypatch.setattr(Figure, "draw_without_rendering", lambda figure: None)
    monkeypatch.setattr(Figure, "savefig", lambda figure, file, **options: file.write(b"<svg>not drawn</svg>"))


class Ended(NamedTuple):
    """How a command ended, and what it printed."""

    code: int
    out: str
    err: str


@pytest.fixture
def fvslam(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Runs the command line within this process; what it prints includes that of libraries in C++."""

    def run(*arguments: object) -> Ended:
        monkeypatch.setattr(sys, "argv", ["fvslam", *map(str, arguments)])
        with pytest.raises(SystemExit) as exit:
            main()
        return Ended(exit.value.code or 0, *capfd.readouterr())

    return run


@pytest.fixture(scope="session")
def write_bag() -> Callable[[Path, Iterable[tuple[str, str, int, dict[str, Any]]]], Path]:
    """Writes a bag by rosbags: of ROS 1 (.bag), else the folder of a ROS 2 bag, of which .mcap or .db3 is the file.

    A message is its topic, its type, when it was received (ns) and its fields by name, those of inner messages as
    mappings; what is left out is zero or empty.
    """
    rosbag1, rosbag2 = pytest.importorskip("rosbags.rosbag1"), pytest.importorskip("rosbags.rosbag2")
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    def default(store: Any, kind: Any) -> Any:
        node, argument = kind
        if node is Nodetype.NAME:
            return make(store, argument, {})
        if node is Nodetype.BASE:
            return "" if argument[0] == "string" else 0
        inner, count = argument
        return np.zeros(count, inner[1][0]) if inner[0] is Nodetype.BASE else [default(store, inner)] * count

    def make(store: Any, type: str, fields: dict[str, Any]) -> Any:
        values = {}
        for name, (node, argument) in store.fielddefs[type][1]:
            value = fields.get(name, fields.get(name.lower()))  # ROS 1 spells K what ROS 2 spells k
            if value is None:
                value = default(store, (node, argument))
            elif node is Nodetype.NAME:
                value = make(store, argument, value)
            elif node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                inner = argument[0]
                if inner[0] is Nodetype.NAME:
                    value = [make(store, inner[1], item) for item in value]
                else:
                    value = np.asarray(value, inner[1][0])
            values[name] = value
        return store.types[type](**values)

    def write(path: Path, messages: Iterable[tuple[str, str, int, dict[str, Any]]]) -> Path:
        first = path.suffix == ".bag"
        store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_JAZZY)
        altitude = "std_msgs/Header header\nfloat32 monotonic\nfloat32 amsl\nfloat32 local\nfloat32 relative"
        store.register(get_types_from_msg(altitude, "mavros_msgs/msg/Altitude"))
        if first:
            store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
        if first:
            writer = rosbag1.Writer(path)
        else:
            plugin = rosbag2.StoragePlugin.MCAP if path.suffix == ".mcap" else rosbag2.StoragePlugin.SQLITE3
            writer = rosbag2.Writer(path.with_suffix(""), version=9, storage_plugin=plugin)
        with writer:
            connections: dict[str, Any] = {}
            for topic, type, received, fields in messages:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, type, typestore=store)
                message = make(store, type, fields)
                data = store.serialize_ros1(message, type) if first else store.serialize_cdr(message, type)
                writer.write(connections[topic], received, data)
        return path if first else path.with_suffix("")

    return write
