"""Whether a difference between two modes is more than chance: paired, with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import bootstrap

from fvslam_graph.core.files import one_line
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.study.results import EXTERNAL, StudyResults

CONFIDENCE = 0.95
RESAMPLES = 9999
MIN_VALUES = 5  # values that tell something about their spread
ALL = "all sequences"
COMPARED = {"ape": "APE", "rpe": "RPE"}
DIFFERENCES_CAPTION = (
    "Ratio of the errors of two modes on the same sequence with the same seed and settings: geometric mean and its "
    "95 % bootstrap interval (percentiles). On one sequence it is over the seeds, and tells chance in the estimator; "
    "over all sequences each counts once, with the mean of its seeds, and it tells chance in the sequences, too. An "
    "interval from five values is too narrow (it holds in five cases of six, not in 19 of 20), and of twenty "
    "comparisons without a difference one looks significant."
)


@dataclass(frozen=True)
class Difference:
    """How two modes compare.

    Attributes:
        metric: Column of the results.
        sequence: Or ALL; with preset and variant where a study has several.
        a, b: The modes.
        ratio: Geometric mean of a / b; below 1, a is better.
        low, high: Its interval; NaN where there are too few pairs for one.
        pairs: How many ratios: seeds, or sequences.
    """

    metric: str
    sequence: str
    a: str
    b: str
    ratio: float
    low: float
    high: float
    pairs: int

    @property
    def significant(self) -> bool:
        """Whether the interval excludes equality."""
        return not (np.isnan(self.low) or self.low <= 1 <= self.high)


def differences(results: StudyResults, seed: int = 0) -> list[Difference]:
    """All pairs of modes, by sequence and, where there are several, over all of them.

    Args:
        results: Other people's trajectories, which have no seeds, are left out.
        seed: Of the resampling.
    """
    own = results.finished[results.finished["preset"] != EXTERNAL]
    alike = own.groupby(["preset", "variant"], sort=False)  # runs with other settings are not of the same kind
    return [
        replace(difference, sequence=", ".join((difference.sequence, *settings)))
        for metric in COMPARED
        for labels, runs in alike
        for settings in [[label for label in labels if label and len(alike) > 1]]
        for difference in _of_metric(runs, metric, seed)
    ]


def _of_metric(own: pd.DataFrame, metric: str, seed: int) -> Iterator[Difference]:
    logs = own.assign(log=np.log(own[metric].where(own[metric] > 0)))
    paired = logs.pivot_table("log", ["sequence", "seed"], "mode", sort=False)
    for a, b in combinations([mode for mode in own["mode"].unique() if mode in paired], 2):
        pairs = (paired[a] - paired[b]).dropna()
        by_sequence = {name: group.to_numpy() for name, group in pairs.groupby("sequence", sort=False)}
        if len(by_sequence) > 1:
            by_sequence[ALL] = np.array([ratios.mean() for ratios in by_sequence.values()])
        for name, ratios in by_sequence.items():
            ratio, low, high = (float(np.exp(value)) for value in (ratios.mean(), *interval(ratios, seed)))
            yield Difference(metric, str(name), a, b, ratio, low, high, len(ratios))


def interval(values: NDArray[np.float64], seed: int) -> tuple[float, float]:
    """Bootstrap interval of the mean of values (n,); NaN where they are too few to tell anything about their spread."""
    if len(values) < MIN_VALUES:
        return np.nan, np.nan
    found = bootstrap(
        (values,),
        np.mean,
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return float(found.low), float(found.high)


def differences_table(found: Sequence[Difference]) -> Table:
    """One row a comparison."""
    rows = [
        [
            COMPARED[difference.metric],
            difference.sequence,
            f"{difference.a} / {difference.b}",
            f"{difference.ratio:.3f}",
            "-" if np.isnan(difference.low) else f"{difference.low:.3f} to {difference.high:.3f}",
            str(difference.pairs),
            "yes" if difference.significant else "no",
        ]
        for difference in found
    ]
    return Table(
        ("error", "sequence", "modes", "ratio", "95 % interval", "pairs", "significant"), rows, 3, DIFFERENCES_CAPTION
    )


def verdicts(found: Sequence[Difference]) -> list[str]:
    """A sentence for each metric and sequence on which differences are significant, and which are not."""
    sentences = []
    for metric, sequence in dict.fromkeys((difference.metric, difference.sequence) for difference in found):
        here = [difference for difference in found if (difference.metric, difference.sequence) == (metric, sequence)]
        unclear = ", ".join(f"{difference.a} and {difference.b}" for difference in here if not difference.significant)
        if any(np.isnan(difference.low) for difference in here):
            what = "sequences" if sequence.startswith(ALL) else "seeds"
            said = f"fewer than {MIN_VALUES} {what}, too few to tell a difference from chance"
        else:
            said = "; ".join((*_better(here), f"not significant: {unclear}" if unclear else "all are significant"))
        sentences.append(one_line(f"{COMPARED[metric]} on {sequence}: {said}."))
    return sentences


def _better(found: Sequence[Difference]) -> Iterator[str]:
    """Sentences on what each mode is significantly better than, and by how much."""
    worse: dict[str, list[str]] = {}
    for difference in found:
        if difference.significant:
            a, b, ratio = difference.a, difference.b, difference.ratio
            better, other = (a, b) if ratio < 1 else (b, a)
            worse.setdefault(better, []).append(f"{other} ({100 * (1 - min(ratio, 1 / ratio)):.2g} %)")
    for better, others in worse.items():
        yield f"{better} is better than {', '.join(others)}"
