"""The outcome of a study: one tidy table of all runs, and its summaries."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fvslam_graph.core.files import write_file, writing
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.report import UNJUDGED
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.study.common_frames import COMMON_COLUMNS
from fvslam_graph.study.jobs import METRIC_COLUMNS, Row

LABELS = ("sequence", "mode", "preset", "variant")
RESULTS = (
    *LABELS,
    "seed",
    "status",
    "scale_source",
    "frames",
    "coverage",
    "tracked",
    "matched",
    "nis",
    *METRIC_COLUMNS,
    *COMMON_COLUMNS,
    "unjudged",
    "note",
    "folder",
)
EXTERNAL = "external"
"""The preset of other people's systems."""
COSTS = ("ms", "ms_p95", "cpu_s", "wall_s", "peak_mb", "waited")
_SYSTEM_COSTS = ("cpu_s", "wall_s")  # all that is known of the time of other systems
_WORDS = (*LABELS, "status", "scale_source", "unjudged", "note", "folder")
_COUNTS = ("seed", "frames")

_SUMMARY = {  # column of the table: its name, digits, factor
    "ape": ("APE (m)", ".3f", 1.0),
    "ape_smoothed": ("smoothed (m)", ".3f", 1.0),
    "rpe": ("RPE (m)", ".4f", 1.0),
    "t_rel": ("t_rel (%)", ".2f", 1.0),
    "r_rel": ("r_rel (deg/100 m)", ".3f", 1.0),
    "nees": ("NEES", ".1f", 1.0),
    "nees_rotation": ("NEES, rotation", ".1f", 1.0),
    "nees_direction": ("NEES, direction", ".1f", 1.0),
    "nis": ("NIS", ".1f", 1.0),
    "coverage": ("coverage (%)", ".1f", 100.0),
    "associated": ("poses", ".0f", 1.0),
    "common": ("common", ".0f", 1.0),
    "ape_common": ("APE, common (m)", ".3f", 1.0),
    "rpe_common": ("RPE, common (m)", ".4f", 1.0),
    "ms": ("ms/frame", ".1f", 1.0),
    "cpu_s": ("CPU (s)", ".1f", 1.0),
    "wall_s": ("wall (s)", ".1f", 1.0),
    "peak_mb": ("peak MB", ".0f", 1.0),
}

_MEANINGS = (
    "APE and RPE (frame to frame): RMSE of translation; smoothed: APE of the smoothed trajectory. t_rel and r_rel: "
    "KITTI's, 100-800 m, without scale correction. NEES: 6, 3 and 2 are consistent; not judged where the noise of the "
    "reference alone would double it, or where its axes are not the camera's. NIS: of V-SLAM's landmarks, 2 is "
    "consistent. poses: those with ground truth. ms/frame: mean without reading images"
)
RESULT_FILES = ("results.csv", "results.parquet", "costs.csv", "summary.md", "summary.tex")
_TIMED_SYSTEMS = (
    " CPU and wall: seconds of the whole run with reading images; of other systems, also with their start, and peak MB "
    "of all their processes."
)
UNDISTURBED = 0.02  # share of the time for which a process may wait for a core
_NEES_PARTS = {"nees": "pose", "nees_rotation": "rotation", "nees_direction": "direction"}


@dataclass(frozen=True)
class StudyResults:
    """All runs of a study, in the order in which they were declared.

    Attributes:
        table: One row a run. The columns RESULTS depend on input, settings and version alone; COSTS were measured. See
            `fvslam_graph.study.jobs.row_of`.
        align: How estimates were brought into the world of the ground truth.
    """

    table: pd.DataFrame
    align: Alignment

    @classmethod
    def of(cls, rows: Iterable[Row], align: Alignment) -> StudyResults:
        """From rows as they come."""
        table = pd.DataFrame(list(rows)).reindex(columns=[*RESULTS, *COSTS])
        numbers = [column for column in table if column not in (*_WORDS, *_COUNTS)]
        types = dict.fromkeys(_COUNTS, "Int64") | dict.fromkeys(numbers, "float64")
        table[list(_WORDS)] = table[list(_WORDS)].astype(object).fillna("").astype(str)
        return cls(table.astype(types), align)

    def __repr__(self) -> str:
        modes, sequences = (self.table[label].nunique() for label in ("mode", "sequence"))
        done = f"{len(self.finished)} of {len(self.table)} runs came to their end"
        return f"StudyResults({modes} modes on {sequences} sequences, {done}, {self.align} alignment)"

    def _repr_html_(self) -> str:
        return self.summary().html()

    @property
    def finished(self) -> pd.DataFrame:
        """The runs that came to their end."""
        return self.table[self.table["status"] == "finished"]

    def lost(self, folder: Path) -> pd.DataFrame:
        """The runs that fail, but have come to their end by the results that a folder holds."""
        try:
            before = pd.read_parquet(folder / "results.parquet")
            done = set(_keys(before[before["status"] == "finished"]))
        except (OSError, ValueError, KeyError):  # none yet, or damaged
            return self.table[:0]
        return self.table[np.array([key in done for key in _keys(self.table)]) & (self.table["status"] != "finished")]

    @property
    def circumstances(self) -> str:
        """What holds of all errors: which trajectories, how they were aligned, where their scale is from."""
        sources = " / ".join(sorted(set(self.finished["scale_source"]) - {""}))
        return f"Online trajectories, {self.align} alignment, scale from {sources or 'nothing'}."

    @property
    def caption(self) -> str:
        """The caption: what a reader has to know of the numbers."""
        failed = len(self.table) - len(self.finished)
        common = (
            "common: how many frames all that came to their end have a pose for, and errors on these; the other errors "
            "are of each one's own frames."
            if self._frames_differ
            else "All that came to their end have a pose for the same frames."
        )
        return (
            f"{' / '.join(self.table['sequence'].unique())}. {self.circumstances} Median, and range over the seeds in "
            f"brackets. {failed} of {len(self.table)} runs failed and have no error. {common} {_MEANINGS}"
            f"{self._sharing}.{_TIMED_SYSTEMS if self._systems_are_timed else ''}"
        )

    @property
    def _sharing(self) -> str:
        """Whether times are those of processes that had a core each."""
        waited = self.finished["waited"].max()
        if np.isnan(waited):
            return ""
        if waited <= UNDISTURBED:
            return ", undisturbed"
        return f"; cores were shared, and runs waited for one up to {100 * waited:.0f} % of the time"

    @property
    def _frames_differ(self) -> bool:
        """Whether some run has errors of other frames than those that all have."""
        known = self.finished.dropna(subset=["associated"])
        return bool((known["common"] != known["associated"]).any())

    @property
    def _systems_are_timed(self) -> bool:
        """Whether other systems were run here."""
        return bool(self.table.loc[self.table["preset"] == EXTERNAL, "wall_s"].notna().any())

    def summary(self) -> Table:
        """One row for each sequence, mode, preset and variant: median and range over the seeds."""
        own = self.table[self.table["preset"] != EXTERNAL]
        shown = [label for label in LABELS if label == "mode" or own[label].nunique() > 1]
        left_out = {
            *(() if self._frames_differ else COMMON_COLUMNS),
            *(() if self._systems_are_timed else _SYSTEM_COSTS),
        }
        columns = {name: what for name, what in _SUMMARY.items() if name not in left_out}
        rows = []
        for common, group in self.table.groupby(list(LABELS), sort=False):
            labels = dict(zip(LABELS, common, strict=True))
            finished = group[group["status"] == "finished"]
            runs = f"{len(finished)}/{len(group)}"
            cells = [
                UNJUDGED if _unjudged(finished, key) else spread(finished[key] * factor, digits)
                for key, (_, digits, factor) in columns.items()
            ]
            scale = "/".join(sorted(set(finished["scale_source"]) - {""})) or "-"
            rows.append([*(labels[label] for label in shown), scale, runs, *cells])
        names = (*shown, "scale", "runs", *(name for name, _, _ in columns.values()))
        return Table(names, rows, len(shown) + 2, self.caption, len(shown))

    def failures(self) -> Table:
        """The runs that did not come to their end, or not with all that they should leave, and why."""
        failed = self.table[(self.table["status"] != "finished") | (self.table["note"] != "")]
        said = failed["status"].where(failed["note"] == "", failed["status"] + ", but " + failed["note"])
        rows = failed[[*LABELS, "seed"]].assign(why=said).astype(object)
        cells = [["-" if pd.isna(cell) else str(cell) for cell in row] for row in rows.to_numpy()]
        return Table(list(rows), cells, 6, keys=4)

    def write(self, folder: Path) -> None:
        """Write RESULT_FILES; results.csv and results.parquet have the columns RESULTS.

        Raises:
            ResultsError: The folder cannot be written.
        """
        results, costs = self.table[list(RESULTS)], self.table[[*LABELS, "seed", *COSTS]]
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            for name, table in (("results", results), ("costs", costs)):
                write_file(folder / f"{name}.csv", table.to_csv(index=False, lineterminator="\n"))
            parquet = io.BytesIO()
            results.to_parquet(parquet, index=False)
            write_file(folder / "results.parquet", parquet.getvalue())
            write_file(folder / "summary.md", self.summary().markdown())
            write_file(folder / "summary.tex", self.summary().latex())


def _unjudged(runs: pd.DataFrame, column: str) -> bool:
    """Whether the reference cannot judge this NEES of any of the runs."""
    part = _NEES_PARTS.get(column)
    return part is not None and bool(runs["unjudged"].str.contains(part).any()) and bool(runs[column].isna().all())


def _keys(table: pd.DataFrame) -> list[tuple[Any, ...]]:
    """The labels that tell runs from each other."""
    return list(zip(*(table[label] for label in LABELS), table["seed"].fillna(-1), strict=True))


def spread(values: Iterable[float], style: str = ".3f") -> str:
    """Median, and the range in brackets where it shows in the digits; "-" without values.

    Small values have more decimals than the style says, for two digits that count, down to 1e-5.
    """
    known = np.array([value for value in values if np.isfinite(value)])
    if not len(known):
        return "-"
    decimals = int(style[1:-1])
    while 1e-5 < np.median(known) < 10 ** (1 - decimals) and 0 < decimals < 6:
        decimals += 1
    median, low, high = (f"{value:.{decimals}f}" for value in (np.median(known), known.min(), known.max()))
    return median if low == high else f"{median} ({low}-{high})"
