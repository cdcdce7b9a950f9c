"""Whether a difference between two modes is more than chance: the unit is the recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fvslam_graph.core.files import one_line
from fvslam_graph.evaluation.tables import Table
from fvslam_graph.study.jobs import VARIANT_SEPARATOR
from fvslam_graph.study.results import EXTERNAL, StudyResults

CONFIDENCE = 0.95
RESAMPLES = 9999
MIN_RECORDINGS = 5  # which tell something about their spread
ALL = "all sequences"
COMPARED = {"ape": "APE", "rpe": "RPE"}
DIFFERENCES_CAPTION = (
    "Ratio of the errors of two modes on the frames that all have a pose for, with the same settings and, where both "
    "have seeds, the same seed. Geometric mean, and in brackets its range: over the seeds on one sequence, over the "
    "sequences on all. n is the number of sequences, each of which counts once, with the mean of its seeds; the 95 % "
    f"interval is a bootstrap over them (percentiles), and there is none below {MIN_RECORDINGS}, as another seed is no "
    "other recording. An interval from five is too narrow (it holds in five cases of six, not in 19 of 20), and of "
    "twenty comparisons without a difference one looks significant. failed: pairs of runs of which one has no error."
)

_Settings = dict[str, str]


@dataclass(frozen=True)
class Difference:
    """How two modes compare.

    Attributes:
        metric: One of COMPARED.
        sequence: Or ALL; with preset and settings where a study has several.
        a, b: The modes.
        ratio: Geometric mean of a / b; below 1, a is better.
        range: The smallest and the largest ratio: of the seeds of one sequence, or of all sequences.
        low, high: 95 % interval over the recordings; NaN where they are too few for one.
        recordings: How many.
        failed: How many pairs of runs have no ratio.
    """

    metric: str
    sequence: str
    a: str
    b: str
    ratio: float
    range: tuple[float, float]
    low: float
    high: float
    recordings: int
    failed: int

    @property
    def significant(self) -> bool:
        """Whether the interval excludes equality."""
        return not (np.isnan(self.low) or self.low <= 1 <= self.high)


def differences(results: StudyResults, seed: int = 0) -> list[Difference]:
    """All pairs of modes, other systems among them, by sequence and, where there are several, over all of them.

    Args:
        results: All runs.
        seed: Of the resampling.
    """
    methods = [
        (str(mode), str(preset), _settings(variant), runs)
        for (preset, variant, mode), runs in results.table.groupby(["preset", "variant", "mode"], sort=False)
    ]
    presets = {preset for _, preset, _, _ in methods} - {EXTERNAL}
    variants = {variant for variant in results.table["variant"] if variant}
    found: list[Difference] = []
    for metric in COMPARED:
        for (a, preset, ours, first), (b, other, theirs, second) in combinations(methods, 2):
            preset = other if preset == EXTERNAL else preset
            alike = other in (preset, EXTERNAL) and all(theirs.get(name, ours[name]) == ours[name] for name in ours)
            if a == b or not alike:
                continue
            both = VARIANT_SEPARATOR.join(f"{name}={value}" for name, value in (ours | theirs).items())
            labels = [preset] * (len(presets) > 1) + [both] * (len(variants) > 1 and bool(both))
            found += _compared(metric, a, b, _ratios(first, second, f"{metric}_common"), labels, seed)
    return found


def _settings(variant: str) -> _Settings:
    """The settings of a variant by their name."""
    return dict(setting.split("=", 1) for setting in variant.split(VARIANT_SEPARATOR) if setting)


def _ratios(a: pd.DataFrame, b: pd.DataFrame, column: str) -> pd.Series:
    """Logarithms of the ratios of all pairs of runs, by sequence; NaN where one of them has no error."""
    both = [a, b]
    paired = ["sequence", *(["seed"] if all(runs["seed"].notna().all() for runs in both) else [])]
    logs = [runs[paired].assign(log=np.log(runs[column].where(runs[column] > 0))) for runs in both]
    merged = logs[0].merge(logs[1], on=paired)
    ratios: pd.Series = (merged["log_x"] - merged["log_y"]).set_axis(merged["sequence"])
    return ratios


def _compared(metric: str, a: str, b: str, ratios: pd.Series, labels: Sequence[str], seed: int) -> Iterator[Difference]:
    """Compare on each sequence that has ratios (by sequence, logarithms), and on all."""
    known = ratios.dropna()
    groups = {str(name): known[name] for name in dict.fromkeys(known.index)}
    means = np.array([np.mean(logs) for logs in groups.values()])
    if len(groups) > 1:
        groups[ALL] = means
    for name, logs in groups.items():
        whole = name == ALL
        values = [np.mean(logs), np.min(logs), np.max(logs), *(interval(means, seed) if whole else (np.nan, np.nan))]
        ratio, smallest, largest, low, high = (float(np.exp(value)) for value in values)
        failed = int(ratios.isna().sum() if whole else ratios[[name]].isna().sum())
        label = ", ".join((name, *labels))
        recordings = len(means) if whole else 1
        yield Difference(metric, label, a, b, ratio, (smallest, largest), low, high, recordings, failed)


def interval(values: NDArray[np.float64], seed: int) -> tuple[float, float]:
    """Bootstrap interval of the mean of values (n,); NaN where they are too few to tell anything about their spread."""
    if len(values) < MIN_RECORDINGS:
        return np.nan, np.nan
    from scipy.stats import bootstrap  # which takes as long to load as all else of a study together

    found = bootstrap(
        (values,),
        np.mean,
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return float(found.low), float(found.high)


def differences_table(found: Sequence[Difference], circumstances: str = "") -> Table:
    """One row a comparison; `circumstances` begin the caption."""
    rows = [
        [
            COMPARED[difference.metric],
            difference.sequence,
            f"{difference.a} / {difference.b}",
            f"{difference.ratio:.3f} ({difference.range[0]:.3f}-{difference.range[1]:.3f})",
            "-" if np.isnan(difference.low) else f"{difference.low:.3f} to {difference.high:.3f}",
            str(difference.recordings),
            str(difference.failed),
            "-" if np.isnan(difference.low) else "yes" if difference.significant else "no",
        ]
        for difference in found
    ]
    columns = ("error", "sequence", "modes", "ratio", "95 % interval", "n", "failed", "significant")
    return Table(columns, rows, 3, f"{circumstances} {DIFFERENCES_CAPTION}".strip())


def verdicts(found: Sequence[Difference]) -> list[str]:
    """A sentence for each metric: which differences over all recordings are significant, and which are not."""
    sentences = []
    several = any(difference.sequence.startswith(ALL) for difference in found)
    whole = [difference for difference in found if difference.sequence.startswith(ALL) or not several]
    for metric, sequence in dict.fromkeys((difference.metric, difference.sequence) for difference in whole):
        here = [difference for difference in whole if (difference.metric, difference.sequence) == (metric, sequence)]
        counts = sorted({difference.recordings for difference in here})
        n = "-".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
        judged = [difference for difference in here if not np.isnan(difference.low)]
        if not judged:
            said = f"too few recordings to tell a difference from chance; {MIN_RECORDINGS} are needed"
        else:
            unclear = ", ".join(f"{one.a} and {one.b}" for one in judged if not one.significant)
            left = f"too few recordings for {len(here) - len(judged)} others" if len(judged) < len(here) else ""
            rest = (f"not significant: {unclear}" if unclear else "all are significant", left)
            said = "; ".join((*_better(judged), *filter(None, rest)))
        sentences.append(one_line(f"{COMPARED[metric]} on {sequence} (n = {n}): {said}."))
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
