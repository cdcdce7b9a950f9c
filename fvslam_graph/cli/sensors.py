"""What other sensors than the camera have measured: options, and the sequence with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fvslam_graph.cli.options import floats
from fvslam_graph.core.errors import FvslamError

if TYPE_CHECKING:
    from fvslam_graph.core.sequence import Sequence

GroundPlane = Annotated[
    str | None, typer.Option(help="Direction from the camera down to the ground, and metres.", metavar="'NX NY NZ D'")
]
Altimeter = Annotated[Path | None, typer.Option(help="CSV of heights above the ground: stamp,height[,sigma].")]
Gnss = Annotated[
    str | None,
    typer.Option(
        help="Fixes for mode graph: CSV of stamp,latitude,longitude,altitude[,sigma]; or `recording`, those that it "
        "has; or oxts:HZ:SIGMA[:OUTLIERS[:GAP_S]], simulated from its OXTS packets or ground truth.",
        metavar="FILE",
    ),
]
GnssSigma = Annotated[float | None, typer.Option(help="Standard deviation of fixes along each axis.", metavar="METRES")]


def with_sensors(
    sequence: Sequence, plane: str | None, altimeter: Path | None, gnss: str | None, sigma: float | None, seed: int
) -> Sequence:
    """The sequence with what other sensors than the camera have measured."""
    from fvslam_graph.core.sensors import SensorKind
    from fvslam_graph.runs.gnss_file import read_fixes
    from fvslam_graph.sequences.altimeter import read_altimeter, with_altimeter
    from fvslam_graph.sequences.ground import with_ground_plane
    from fvslam_graph.simulation.gnss import SimulatedReceiver

    if plane is not None:
        sequence = with_ground_plane(sequence, floats(plane, "--ground-plane", "four numbers, nx ny nz d"))
    if altimeter is not None:
        sequence = with_altimeter(sequence, read_altimeter(altimeter))
    if gnss is None and sigma is not None:
        raise FvslamError("--gnss-sigma is the deviation of the fixes that --gnss gives; give both")
    if gnss is None:
        return sequence
    if gnss == "recording":
        fixes = next((series for series in sequence.sensors if series.kind is SensorKind.GNSS), None)
        if fixes is None:
            raise FvslamError(f"{sequence.name} has no fixes of a GNSS receiver; give --gnss FILE")
    elif gnss.startswith("oxts:"):
        fixes = SimulatedReceiver.parse(gnss.removeprefix("oxts:")).fixes(sequence, seed)
    else:
        fixes = read_fixes(Path(gnss))
    return sequence.with_gnss(fixes, sigma)
