"""Gates for squared deviations."""

from __future__ import annotations

import math


def chi2_gate(probability: float, degrees_of_freedom: int) -> float:
    """The quantile of the chi-square distribution: squared deviations are below it with a probability.

    By bisection, since loading SciPy's would take a quarter of the time that the program needs to begin.
    """
    low, high = 0.0, 1.0
    while _exceeding(high, degrees_of_freedom) > 1 - probability:
        high *= 2
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if _exceeding(middle, degrees_of_freedom) > 1 - probability else (low, middle)
    return high


def _exceeding(square: float, degrees_of_freedom: int) -> float:
    """The probability of a squared deviation above `square`.

    Source: Abramowitz, Stegun, "Handbook of mathematical functions", 26.4.4 and 26.4.5.
    """
    half, odd = square / 2, degrees_of_freedom % 2
    powers = (order + odd / 2 for order in range(degrees_of_freedom // 2))
    terms = [half**power * math.exp(-half) / math.gamma(power + 1) for power in powers]
    return sum(terms, math.erfc(math.sqrt(half)) if odd else 0.0)
