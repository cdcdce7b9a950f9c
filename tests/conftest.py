"""What several tests share."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="session")
def real_data() -> Callable[[str], Path]:
    """The folder of a real recording, by its name below FVSLAM_DATA; skips the test where it is absent."""

    def find(name: str) -> Path:
        path = Path(os.environ.get("FVSLAM_DATA", ROOT.parent / "shared" / "data")) / name
        if not path.exists():
            pytest.skip(f"real sequence {name} is not at {path}; set FVSLAM_DATA to its folder")
        return path

    return find
