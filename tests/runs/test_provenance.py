"""Under which circumstances a run was made."""

import subprocess
from pathlib import Path

import pytest

import fvslam_graph
from fvslam_graph.runs.provenance import provenance

ROOT = Path(fvslam_graph.__file__).parents[1]


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no checkout")
def test_the_revision_is_that_of_the_checkout():
    head = subprocess.run(["git", "-C", str(ROOT), "rev-parse", "HEAD"], capture_output=True, text=True, check=True)
    assert provenance()["git"].removesuffix("-dirty") == head.stdout.strip()
