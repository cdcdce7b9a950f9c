"""Runs in memory as rows of numbers."""

import math

import pytest

from fvslam_graph.study import Job, execute

SHORT = "synthetic:uav?frames=24"


@pytest.mark.parametrize("mode", ["vo", "graph"])
def test_a_row_of_numbers(mode):
    row = execute(Job(SHORT, settings=(f"mode={mode}",), seed=3))
    assert (row["mode"], row["preset"], row["seed"], row["scale_source"]) == (mode, "tuned", 3, "plane")
    assert row["coverage"] == row["tracked"] == 1.0
    assert 0 < row["ape"] < 0.1  # metres on 29 m; measured 0.01
    assert 25 < row["path"] < 35 and row["ms"] > 0
    assert math.isnan(row["ape_smoothed"]) == math.isnan(row["matched"]) == (mode == "vo")


def test_the_same_job_is_the_same_row():
    job = Job(SHORT, frames="0:12", settings=("mode=average",))
    first, second = execute(job), execute(job)
    assert all(first[key] == second[key] or math.isnan(first[key]) for key in first if key != "ms")


def test_frames_are_those_asked_for():
    assert execute(Job(SHORT, frames="0:12"))["path"] < 0.6 * execute(Job(SHORT))["path"]
