import pytest

from fvslam_graph.core import stopwatch
from fvslam_graph.core.stopwatch import Stopwatch


def test_nested_and_repeated_stages(monkeypatch):
    now = iter([0.0, 1.0, 3.0, 3.5, 4.0, 10.0, 20.0, 20.25])
    monkeypatch.setattr(stopwatch.time, "perf_counter", lambda: next(now))
    watch = Stopwatch()
    with watch.stage("pose"):
        with watch.stage("scale"):
            pass
        with watch.stage("detection"):
            pass
    with watch.stage("scale"):
        pass
    assert watch.times == {"pose": 7500, "scale": 2250, "detection": 500}


def test_a_stage_that_fails_is_counted():
    watch = Stopwatch()
    with pytest.raises(ValueError, match="bad"), watch.stage("pose"):
        raise ValueError("bad")
    assert list(watch.times) == ["pose"]
