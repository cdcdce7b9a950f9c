"""The four ways to bring an estimate into the world of its reference."""

from __future__ import annotations

from enum import StrEnum

from fvslam_graph.core.errors import FvslamError


class Alignment(StrEnum):
    """How the estimate is brought into the world of the reference before they are compared."""

    NONE = "none"
    ORIGIN = "origin"  # the first poses coincide
    SE3 = "se3"  # least squares over all positions (Umeyama)
    SIM3 = "sim3"  # the same with one scale factor

    @classmethod
    def named(cls, name: str) -> Alignment:
        """Return the one of a name; raises FvslamError where there is none."""
        if name not in list(cls):
            raise FvslamError(f"the alignment is one of {', '.join(cls)}, not '{name}'")
        return cls(name)
