"""The four ways to bring an estimate into the world of its reference."""

from enum import StrEnum
from typing import NoReturn

from fvslam_graph.errors import FvslamError


class Alignment(StrEnum):
    """How the estimate is brought into the world of the reference before they are compared."""

    NONE = "none"
    ORIGIN = "origin"  # the first poses coincide
    SE3 = "se3"  # least squares over all positions (Umeyama)
    SIM3 = "sim3"  # the same with one scale factor

    @classmethod
    def _missing_(cls, value: object) -> NoReturn:
        raise FvslamError(f"the alignment is one of {', '.join(cls)}, not '{value}'")

    @property
    def options(self) -> dict[str, bool]:
        """As evo's `ape` and `rpe` take it."""
        return {
            Alignment.NONE: {},
            Alignment.ORIGIN: {"align_origin": True},
            Alignment.SE3: {"align": True},
            Alignment.SIM3: {"align": True, "correct_scale": True},
        }[self]
