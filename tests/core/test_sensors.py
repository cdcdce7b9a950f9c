import numpy as np

from fvslam_graph.core.sensors import SensorKind, SensorSeries


def test_readings_are_interpolated_but_for_gaps_and_outside():
    stamps = np.array([0.0, 0.1, 0.2, 2.0])
    series = SensorSeries(
        SensorKind.RANGE, stamps, np.array([[1.0], [3], [0.1], [7]]), np.full((4, 1), np.nan), "/range"
    )
    at = np.array([-0.01, 0, 0.05, 0.1, 0.2, 0.21, 2.0, 2.01])
    np.testing.assert_array_equal(series.interpolate(at)[:, 0], [np.nan, 1, 2, 3, 0.1, np.nan, 7, np.nan])
