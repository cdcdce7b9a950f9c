import pytest
from scipy.stats import chi2

from fvslam_graph.core.gates import chi2_gate


@pytest.mark.parametrize(("probability", "degrees_of_freedom"), [(0.99, 2), (0.999, 2), (0.999, 6), (0.9999, 1)])
def test_quantiles(probability, degrees_of_freedom):
    assert chi2_gate(probability, degrees_of_freedom) == pytest.approx(chi2.ppf(probability, degrees_of_freedom))
