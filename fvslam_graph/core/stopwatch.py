"""How long each stage of a frame takes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class Stopwatch:
    """Sums up milliseconds by stage; the time of a stage within another one counts for the inner one alone."""

    def __init__(self) -> None:
        self.times: dict[str, float] = {}
        self._inner = 0.0  # of the stages that ended within the present one

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time of the enclosed block as stage `name`."""
        start = time.perf_counter()
        outer, self._inner = self._inner, 0.0
        try:
            yield
        finally:
            elapsed = 1e3 * (time.perf_counter() - start)
            self.times[name] = self.times.get(name, 0.0) + elapsed - self._inner
            self._inner = outer + elapsed
