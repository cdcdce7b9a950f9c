"""One number of a study by two of its labels, as a table for a paper: LaTeX, Markdown or CSV."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
import pandas as pd

from fvslam_graph.core.errors import StudyError
from fvslam_graph.core.files import one_line
from fvslam_graph.core.yaml_files import read_yaml_mapping
from fvslam_graph.evaluation.tables import latex_escaped
from fvslam_graph.study.results import LABELS

HIGHER_IS_BETTER = ("coverage", "tracked", "matched", "common", "associated")
NO_BEST = ("scale", "nees", "nees_rotation", "nees_direction", "nis", "path", "frames")  # of which less is no better
METRIC_UNITS = {
    **dict.fromkeys(("ape", "rpe", "rpe_1m", "ape_common", "rpe_common", "ape_smoothed", "path"), "m"),
    **dict.fromkeys(("t_rel", "t_rel_scaled"), "%"),
    **{"ape_rot": "deg", "r_rel": "deg/100 m"},
}
SIGNIFICANT = 3  # significant, of the smallest number
MISSING = "--"


class TableFormat(StrEnum):
    """What a table is written as."""

    LATEX = "latex"  # needs the packages booktabs, graphicx and siunitx
    MARKDOWN = "md"
    CSV = "csv"


@dataclass(frozen=True)
class MetricTable:
    """Medians over all runs that have the same two labels.

    Attributes:
        values: The numbers, NaN where no run has one; rows and columns in the order of the study.
        metric: Column of the results that they are of.
        caption: What holds of them.
    """

    values: pd.DataFrame
    metric: str
    caption: str

    @classmethod
    def of(cls, study: Path, rows: str, columns: str, metric: str) -> MetricTable:
        """Read the folder of a study that came to its end.

        Args:
            study: The folder.
            rows, columns: Labels of runs: "sequence", "mode", "preset", "variant" or "seed".
            metric: Column of results.csv that holds numbers, such as "ape" or "ape_common".

        Raises:
            StudyError: The folder has no results, or there is no such label or number.
        """
        try:
            runs = pd.read_parquet(study / "results.parquet")
        except (OSError, ValueError) as error:
            reason = one_line(str(error))
            raise StudyError(f"{study} has no results of a study; give the folder of one ({reason})") from None
        labels, metrics = (*LABELS, "seed"), [name for name in runs.select_dtypes("number") if name != "seed"]
        for what, name, known in (("row", rows, labels), ("column", columns, labels), ("metric", metric, metrics)):
            if name not in known:
                raise StudyError(f"there is no {what} '{name}', only {', '.join(known)}")
        if rows == columns:
            raise StudyError(f"rows and columns are both '{rows}'; choose two labels")
        grouped = runs.groupby([rows, columns], sort=False, dropna=False)[metric]
        values = grouped.median().unstack(columns).astype(float)
        values = values.reindex(index=runs[rows].unique(), columns=runs[columns].unique())
        return cls(values, metric, _caption(study, runs, rows, columns, metric))

    def text(self, layout: TableFormat) -> str:
        """The table as it is written."""
        if layout is TableFormat.CSV:
            return str(self.values.to_csv(lineterminator="\n"))
        return self._latex() if layout is TableFormat.LATEX else self._markdown()

    @property
    def decimals(self) -> int:
        """Behind the point, so that the smallest number has SIGNIFICANT significant ones."""
        known = np.abs(self.values.to_numpy())
        known = known[np.isfinite(known) & (known > 0)]
        return 0 if not len(known) else int(np.clip(SIGNIFICANT - 1 - np.floor(np.log10(known.min())), 0, 6))

    def ranks(self) -> pd.DataFrame:
        """1 for the best of each sequence, 2 for the second; what is printed alike is alike, and NaN has none."""
        shown = self.values.round(self.decimals)
        if self.metric in NO_BEST:
            return shown * np.nan
        along = 1 if self.values.index.name == "sequence" else 0
        return shown.rank(axis=along, method="min", ascending=self.metric not in HIGHER_IS_BETTER)

    def _markdown(self) -> str:
        marks = {1: "**{}**", 2: "<u>{}</u>"}
        ranks = self.ranks()
        lines = [["", *map(str, self.values)], ["---", *(["---:"] * len(self.values.columns))]]
        for name, row in self.values.iterrows():
            cells = [
                MISSING if np.isnan(value) else marks.get(rank, "{}").format(f"{value:.{self.decimals}f}")
                for value, rank in zip(row, ranks.loc[name], strict=True)
            ]
            lines.append([str(name), *cells])
        return "".join(f"| {' | '.join(line)} |\n" for line in lines) + f"\n{self.caption}\n"

    def _latex(self) -> str:
        known = [abs(value) for value in self.values.to_numpy().ravel() if np.isfinite(value)]
        form = f"{max((len(f'{value:.0f}') for value in known), default=1)}.{self.decimals}"
        ranks = self.ranks()
        style = self.values.rename_axis(index=None, columns=None).style
        style = style.format(precision=self.decimals, na_rep=f"{{{MISSING}}}")
        style = style.format_index(escape="latex").format_index(escape="latex", axis=1)
        style = style.apply(
            lambda _: np.select([ranks == 1, ranks == 2], ["bfseries:;", "underline:--rwrap;"], ""), None
        )
        column = f"S[table-format={form},detect-weight,mode=text]"
        tabular = style.to_latex(
            column_format=f"l*{{{len(self.values.columns)}}}{{{column}}}", hrules=True, siunitx=True
        )
        # In a column of siunitx, what is more than a number has to be in braces.
        tabular = re.sub(
            r"\\underline\{([^}]*)\}", rf"{{\\underline{{\\tablenum[table-format={form}]{{\1}}}}}}", tabular
        )
        return "\n".join(
            (
                "% needs \\usepackage{booktabs,graphicx,siunitx}",
                r"\begin{table}",
                r"  \centering",
                rf"  \caption{{{latex_escaped(self.caption)}}}",
                rf"  \label{{tab:{self.metric}}}",
                r"  \sbox0{%",
                tabular.rstrip().removesuffix("\n") + "}%",
                r"  \ifdim\wd0>\linewidth\resizebox{\linewidth}{!}{\usebox0}\else\usebox0\fi",
                r"\end{table}",
                "",
            )
        )


def _caption(study: Path, runs: pd.DataFrame, rows: str, columns: str, metric: str) -> str:
    """What a reader has to know of the numbers, in a few sentences."""
    align = read_yaml_mapping(study / "study.yaml", StudyError).get("align", "unknown")
    done = runs[runs["status"] == "finished"]
    sources = " / ".join(sorted(set(done["scale_source"]) - {""})) or "nothing"
    unit = f" ({METRIC_UNITS[metric]})" if metric in METRIC_UNITS else ""
    which = "smoothed" if metric == "ape_smoothed" else "online"
    frames = (
        "on the frames that all methods have a pose for" if metric.endswith("_common") else "on each one's own frames"
    )
    lost = runs[runs["status"] != "finished"].groupby([rows, columns], sort=False, dropna=False).size()
    failed = ", ".join(f"{count} of {' on '.join(map(str, names))}" for names, count in lost.items())
    best = "" if metric in NO_BEST else " Bold is the best of a sequence, underlined the second."
    return one_line(
        f"{metric}{unit}, {which} trajectories, {frames}, {align} alignment, scale from {sources}: median over "
        f"{len(runs)} runs with {runs['seed'].nunique()} seeds.{best} Runs that failed: {failed or 'none'}."
    )
