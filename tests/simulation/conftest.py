"""Renders anew what is rendered."""

import pytest

from fvslam_graph.simulation import synthetic


@pytest.fixture(autouse=True)
def rendered_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here it is the rendering that is tested: nothing is kept of it."""
    monkeypatch.setattr(synthetic, "_build", synthetic._build.__wrapped__)
