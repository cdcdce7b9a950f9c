"""When visual SLAM takes its turn."""

from fvslam_graph.fusion.schedule import InterleaveSchedule


def test_fixed():
    interleave = InterleaveSchedule(5, shorten=False)
    for well in (True, False, True, False):
        interleave.report(well)
        assert interleave.distance == 5


def test_shortened_by_failures_and_grown_again():
    interleave = InterleaveSchedule(5, shorten=True)
    distances = []
    for well in (False, False, False, True, True, True, True, True):
        interleave.report(well)
        distances.append(interleave.distance)
    assert distances == [2, 1, 1, 2, 3, 4, 5, 5]
