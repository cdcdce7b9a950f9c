"""Fixes of a GNSS receiver as CSV, beside a run or from elsewhere."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.sensors import SensorKind, SensorSeries
from fvslam_graph.core.text_files import read_text

FIX_COLUMNS = ("stamp", "latitude", "longitude", "altitude")
SIGMA = "sigma"


def write_fixes(path: Path, fixes: SensorSeries) -> None:
    """Write stamps (s) and places (degrees, m), with all digits of the places; read them again by `read_fixes`."""
    rows = [
        f"{stamp:.9f},{','.join(f'{number:.17g}' for number in place)}"
        for stamp, place in zip(fixes.stamps, fixes.values, strict=True)
    ]
    path.write_text("\n".join([",".join(FIX_COLUMNS), *rows]) + "\n")


def read_fixes(path: Path) -> SensorSeries:
    """Read the columns stamp, latitude, longitude, altitude, in the order of the stamps, each stamp once.

    A column sigma, where there is one, has their standard deviations along each axis, metres. Rows with an empty cell
    are left out.

    Raises:
        ResultsError: The file cannot be read, lacks a column, or a cell is no number or no place on Earth.
    """
    reader = csv.DictReader(read_text(path, ResultsError).splitlines(), skipinitialspace=True)
    if missing := [name for name in FIX_COLUMNS if name not in (reader.fieldnames or ())]:
        raise ResultsError(f"{path} has no column {missing[0]}; the first line names {', '.join(FIX_COLUMNS)}")
    names = (*FIX_COLUMNS, *({SIGMA} & set(reader.fieldnames or ())))
    rows = []
    for number, row in enumerate(reader, 2):
        cells = [row[name] or "" for name in names]
        if not all(cell.strip() for cell in cells):
            continue
        try:
            values = [float(cell) for cell in cells]
        except ValueError:
            raise ResultsError(f"{path}: line {number} is not a row of numbers: {','.join(cells)[:60]}") from None
        if not np.isfinite(values).all() or abs(values[1]) > 90 or abs(values[2]) > 180:
            raise ResultsError(f"{path}: line {number} is no place on Earth at a time: {','.join(cells)[:60]}")
        rows.append(values)
    fixes = np.array(rows).reshape(-1, len(names))
    fixes = fixes[np.unique(fixes[:, 0], return_index=True)[1]]
    sigmas = np.full((len(fixes), 3), np.nan)
    if SIGMA in names:
        sigmas = np.repeat(fixes[:, 4:], 3, axis=1)
    return SensorSeries(SensorKind.GNSS, fixes[:, 0], fixes[:, 1:4], sigmas, path.name)
