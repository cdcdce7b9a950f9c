"""The formats that a run is exported to, and the one function that does it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.files import writing
from fvslam_graph.runs.export import colmap, csv_table, euroc, g2o, geo, ros2
from fvslam_graph.runs.export.georeference import Georeference
from fvslam_graph.runs.export.poses import ExportedPoses
from fvslam_graph.runs.gnss_file import read_fixes
from fvslam_graph.runs.results import Run

WRITERS: dict[str, Callable[[Path, ExportedPoses], tuple[str, ...]]] = {
    "csv": csv_table.write,
    "ros2": ros2.write,
    "euroc": euroc.write,
    "colmap": colmap.write,
    "g2o": g2o.write,
}
"""Each writes a file or makes a folder, and returns what its reader should know, a sentence each."""

MAP_WRITERS: dict[str, Callable[[Path, ExportedPoses, Georeference], None]] = {
    "kml": geo.write_kml,
    "gpx": geo.write_gpx,
    "geojson": geo.write_geojson,
}
"""Formats that need a place on Earth."""

FOLDERS = ("ros2", "euroc", "colmap")  # the others are files, whose suffix is the format's name
RELATIVE = ("map", "unit")  # scale sources that do not tell metres


@dataclass(frozen=True)
class Export:
    """What was written.

    Attributes:
        path: The file or folder.
        notes: What its reader should know, one sentence each.
    """

    path: Path
    notes: tuple[str, ...]


def export_name(run: Run, format: str, smoothed: bool) -> str:
    """The name of the file or folder that an export has by default."""
    name = f"{run.name}-smoothed" if smoothed else run.name
    return f"{name}-{format}" if format in FOLDERS else f"{name}.{format}"


def export_run(
    run: Run,
    format: str,
    out: Path,
    smoothed: bool = False,
    origin: Sequence[float] | None = None,
    gnss: Path | None = None,
) -> Export:
    """Write the poses of a run in the format of another program.

    Args:
        run: In memory or read from its folder, which alone has the files of the factor graph.
        format: A key of WRITERS or MAP_WRITERS.
        out: A file or folder that does not exist yet.
        smoothed: The poses by all measurements, which have no covariances, in place of the online ones.
        origin: Where the first camera is; see `Georeference.by_origin`. For maps.
        gnss: A file of fixes, see `read_fixes`, in place of those that the run has. For maps.

    Raises:
        FvslamError: The format is unknown, its library is not installed, `out` exists or cannot be written, the run
            lacks what the format needs, or nothing tells where on Earth a map is.
    """
    if format not in {**WRITERS, **MAP_WRITERS}:
        raise ResultsError(f"there is no format '{format}'; it is one of {', '.join([*WRITERS, *MAP_WRITERS])}")
    if format in WRITERS and (origin is not None or gnss is not None):
        raise ResultsError(f"an origin or GNSS fixes place a map ({', '.join(MAP_WRITERS)}); {format} has no place")
    poses = ExportedPoses.of(run, smoothed)
    with _new(out) as path:
        if format in WRITERS:
            return Export(out, WRITERS[format](path, poses))
        place = _place(poses, origin, gnss)
        MAP_WRITERS[format](path, poses, place)
    notes = [place.note]
    if origin is not None and run.info.get("scale_source") in RELATIVE:
        notes.append("the scale of the run is relative, so that distances on the map are not metres")
    return Export(out, tuple(notes))


def _place(poses: ExportedPoses, origin: Sequence[float] | None, gnss: Path | None) -> Georeference:
    if gnss is not None and origin is not None:
        raise ResultsError("an origin and GNSS fixes cannot both place a map; give one of them")
    if origin is not None:
        return Georeference.by_origin(origin, poses.run.info.get("down"))
    if gnss is None and (placement := poses.run.info.get("placement")) is not None:
        return Georeference.by_placement(placement)
    fixes = poses.run.gnss if gnss is None else read_fixes(gnss)
    if fixes is not None:
        return Georeference.by_fixes(fixes, poses.trajectory)
    raise ResultsError(
        f"nothing tells where on Earth {poses.run.name} is; --origin LAT,LON,ALT[,HEADING] places its first camera, "
        "--gnss FILE its path"
    )


@contextmanager
def _new(out: Path) -> Iterator[Path]:
    """A path beside `out`, of the same name, that becomes `out` when the block ends well."""
    if os.path.lexists(out):
        raise ResultsError(f"{out} exists and is not written over; give another --out")
    with writing(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="writing_", dir=out.parent) as folder:
            path = Path(folder) / out.name
            yield path
            path.rename(out)
