"""Gates for squared deviations."""

from __future__ import annotations

from scipy.special import chdtri


def chi2_gate(probability: float, degrees_of_freedom: int) -> float:
    """The quantile of the chi-square distribution: squared deviations are below it with a probability."""
    return float(chdtri(degrees_of_freedom, 1 - probability))
