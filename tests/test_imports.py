"""Imports run one way: from the faces down to the core."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "fvslam_graph"

# The layers that a layer may import, besides itself.
ALLOWED = {
    "core": set(),
    "features": {"core"},
    "vo": {"core", "features"},
    "slam": {"core", "features"},
    "graph": {"core", "features"},
    "fusion": {"core", "graph"},
    "simulation": {"core"},
    "sequences": {"core"},
    "estimator": {"core", "vo", "slam", "fusion"},
    "runs": {"core"},
    "datasets": {"core", "runs"},
    "pipeline": {"core", "estimator", "runs"},
    "evaluation": {"core", "sequences", "simulation", "vo", "slam", "fusion", "estimator", "runs"},
    "study": {"core", "sequences", "pipeline", "runs", "evaluation"},
}
LOWER = set(ALLOWED)
FACES = {
    "api": LOWER,
    "cli": LOWER | {"api"},
    "testing": LOWER | {"api"},
    "__main__": {"cli"},
    "__init__": {"api", "core", "testing"},
}
# What opens recordings opens synthetic worlds, too; all modes on simulated points are measured by evaluation.
EXCEPTIONS = {"sequences/open.py": {"simulation"}}

MODULES = sorted(PACKAGE.rglob("*.py"))


def layers(module: Path) -> set[str]:
    """The layers that a module imports, also for types alone, and inside functions."""
    found = set()
    for node in ast.walk(ast.parse(module.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [f"{node.module}.{name.name}" for name in node.names]
        for name in names:
            top, _, rest = name.partition(".")
            if top == PACKAGE.name and rest and not rest.startswith("__version__"):
                found.add(rest.split(".")[0])
    return found


@pytest.mark.parametrize("module", MODULES, ids=lambda module: str(module.relative_to(PACKAGE)))
def test_a_layer_imports_lower_ones_alone(module):
    name = module.relative_to(PACKAGE)
    layer = name.parts[0].removesuffix(".py")
    allowed = (ALLOWED | FACES)[layer] | {layer} | EXCEPTIONS.get(name.as_posix(), set())
    assert layers(module) <= allowed


def test_the_root_holds_faces_pipeline_and_estimator():
    modules = {path.stem for path in PACKAGE.glob("*.py")}
    packages = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert modules == {*FACES, "pipeline", "estimator"} - {"cli"}
    assert packages == {*LOWER, "cli"} - {"pipeline", "estimator"}


@pytest.mark.parametrize(
    ("library", "where"),
    [
        (
            "evo",
            {"core/trajectory.py", "evaluation/association.py", "evaluation/metrics.py", "evaluation/pose_errors.py"},
        ),
        ("dask", {"study/execution.py"}),
        ("rosbags", {"runs/export/ros2.py", "sequences/ros/reader.py"}),
        ("pooch", {"datasets/download.py"}),
        ("psutil", {"study/measured_process.py"}),
        ("distributed", {"study/execution.py"}),
    ],
)
def test_libraries_that_few_modules_import(library, where):
    found = set()
    for module in MODULES:
        for node in ast.walk(ast.parse(module.read_text())):
            names = [name.name for name in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if any(name.split(".")[0] == library for name in names):
                found.add(module.relative_to(PACKAGE).as_posix())
    assert found <= where


FIRST_POSE = """
import sys
from itertools import islice
from fvslam_graph.core.config import load_config
from fvslam_graph.pipeline import frame_estimator, resolve_config, through
from fvslam_graph.sequences.open import open_sequence
sequence = open_sequence(sys.argv[1])
estimator = frame_estimator(sequence, resolve_config(load_config(), sequence))
print(*(result.status for result in islice(through(estimator, sequence), 2)))
print(*{name.partition(".")[0] for name in sys.modules})
"""


def test_odometry_loads_nothing_that_it_does_without(drive):
    command = [sys.executable, "-c", FIRST_POSE, str(drive)]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    statuses, modules = process.stdout.splitlines()
    assert statuses == "static tracked"
    others = {
        "scipy",
        "pandas",
        "pyarrow",
        "evo",
        "matplotlib",
        "dask",
        "jinja2",
        "rich",
        "typer",
        "rosbags",
        "pymap3d",
    }
    assert not set(modules.split()) & others
