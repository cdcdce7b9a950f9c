"""A short flight, and jobs on it."""

import pytest

from fvslam_graph.core.config import load_config
from fvslam_graph.study.jobs import Job
from fvslam_graph.study.sources import Source

SHORT = "synthetic:uav?frames=12&size=320x240"


@pytest.fixture(scope="session")
def job():
    """Makes a job on the short flight from settings."""

    def make(*settings: str, path: str = SHORT, preset: str = "tuned", variant: str = "", **source) -> Job:
        return Job(Source(path=path, **source), load_config(preset, settings=list(settings)), variant)

    return make
