"""What is wrong in the middle of a recording may cost the pose; the covariance says so."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from fvslam_graph.core.config import load_config
from fvslam_graph.core.trajectory import Status
from fvslam_graph.estimator import estimate
from fvslam_graph.simulation.disturbed import DISTURBANCES
from fvslam_graph.testing import rendered

SCRIPT = Path(__file__).parents[1] / "scripts" / "disturbances.py"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("disturbances", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def street():
    return rendered("drive", frames=40, size="480x150")


@pytest.mark.parametrize("mode", ["vo", "average", "vslam"])
@pytest.mark.parametrize("name", ["frozen", "dark", "picture", "object"])
def test_later_frames_are_within_three_sigma(script, street, mode, name):
    disturbed = DISTURBANCES[name](street, 8, np.random.default_rng(0))
    results = list(estimate(disturbed.sequence, load_config(settings=[f"mode={mode}"])))
    row = script.judge(disturbed, results, relative=False)
    assert row.inside(slice(disturbed.after, None)) >= 0.95
    assert row.sigma[-1] < 100  # of 40 m of street


@pytest.mark.parametrize("mode", ["vo", "average", "vslam"])
def test_a_repeated_image_is_a_duplicate_and_no_stop(script, street, mode):
    disturbed = DISTURBANCES["repeated"](street, 8, np.random.default_rng(0))
    results = list(estimate(disturbed.sequence, load_config(settings=[f"mode={mode}"])))
    assert [result.index for result in results if result.status is Status.SKIPPED] == [8]
    assert {result.status for result in results[9:]} == {Status.TRACKED}
    assert script.judge(disturbed, results, relative=False).recovered == 0


@pytest.mark.parametrize("mode", ["vo", "average"])
def test_images_in_the_wrong_order_are_not_followed(street, mode):
    disturbed = DISTURBANCES["swapped"](street, 20, np.random.default_rng(0))
    results = list(estimate(disturbed.sequence, load_config(settings=[f"mode={mode}"])))
    assert results[20].status is Status.COASTED and results[22].status is Status.TRACKED
    error = results[22].pose.mean.between(disturbed.sequence.ground_truth.poses[22]).translation()
    assert np.linalg.norm(error) < 0.6  # of 20 m; where the images are believed in their order, 1 m and more


def test_the_table(script, drive, capsys):
    script.main(drive, "vo", 0, ":", 0.4, ["none", "repeated"], [])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[2:]] == ["none", "repeated"]
    assert "100 %" in lines[2]
