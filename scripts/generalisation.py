"""What holds on recordings that took no part in a choice: half of a study's sequences decide, the others report."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from one_sentence import one_sentence
from pages import save_table

from fvslam_graph.evaluation.tables import Table
from fvslam_graph.study.statistics import interval

CAPTION = (
    "APE after the study's alignment, median over seeds, against {against}: geometric mean over sequences, its 95 % "
    "bootstrap interval over sequences, and the worst one. Of the variants of a mode, that which is best on the "
    "deciding half ({decide}) is marked *; what it is worth stands in the other half ({report})."
)


def halves(names: list[str]) -> tuple[list[str], list[str]]:
    """Split names by their hash, so that nobody chooses who decides; another sequence moves none of the others far."""
    order = sorted(names, key=lambda name: hashlib.blake2b(name.encode()).hexdigest())
    return sorted(order[::2]), sorted(order[1::2])


def ratios(results: pd.DataFrame, against: str) -> pd.DataFrame:
    """APE of each mode and variant (rows) over that of a mode in the same variant or the only one, by sequence."""
    finished = results[results["status"] == "finished"]
    median = finished.groupby(["mode", "variant", "sequence"], sort=False)["ape"].median().unstack("sequence")
    base = median.loc[against].reindex([variant for _, variant in median.index])
    return median.div(base.set_axis(median.index))


def cells(row: pd.Series, sequences: list[str]) -> list[str]:
    """Geometric mean with its interval, and the worst sequence; how many have no value."""
    known = row[sequences].dropna()
    if known.empty:
        return ["-", "-", "-"]
    logs = np.log(known.to_numpy(float))
    low, high = np.exp(interval(logs, 0))
    missing = len(sequences) - len(known)
    mean = f"{np.exp(logs.mean()):.2f}" + (f" ({missing} failed)" if missing else "")
    return [mean, "-" if np.isnan(low) else f"{low:.2f} to {high:.2f}", f"{known.max():.2f} {known.idxmax()}"]


def label(mode: str, variant: str, chosen: bool) -> str:
    """Name of a row."""
    return " ".join(filter(None, (mode, variant, "*" if chosen else "")))


def main(
    study: Annotated[Path, typer.Argument(help="Folder of a study that `fvslam study` has made.")],
    against: Annotated[str, typer.Option(help="The mode that the others are compared with.")] = "vo",
) -> None:
    found = ratios(pd.read_csv(study / "results.csv", keep_default_na=False, na_values={"ape": [""]}), against)
    decide, report = halves(list(found.columns))
    deciding = np.log(found[decide]).mean(axis=1)
    best = set(deciding.groupby("mode").idxmin())
    several = found.index.get_level_values("mode").value_counts()
    rows = [
        [label(mode, variant, several[mode] > 1 and (mode, variant) in best), *cells(row, decide), *cells(row, report)]
        for (mode, variant), row in found.iterrows()
    ]
    columns = ("mode", "deciding half", "95 %", "worst", "other half", "95 %", "worst")
    caption = CAPTION.format(against=against, decide=", ".join(decide), report=", ".join(report))
    table = Table(columns, rows, caption=caption)
    save_table(study, "generalisation", table)


if __name__ == "__main__":
    with one_sentence():
        typer.run(main)
