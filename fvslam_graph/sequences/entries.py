"""The keys of a calibration file: looked up under every spelling, and those that nobody looked up."""

from __future__ import annotations

import difflib
import re
from pathlib import Path
from typing import Any

import numpy as np

from fvslam_graph.core.errors import CameraError
from fvslam_graph.core.yaml_files import read_yaml_mapping

CLOSE = 0.8  # similarity of two keys from which on one is taken for a typing error
# What speaks of the lens must not be left out, however it is spelt.
_LENS = re.compile(r".*(dist|coef|skew|radial|tangential|fisheye).*|(.*\.)?[kp]\d")


class Entries:
    """A mapping of a calibration file.

    Upper and lower case, underscores and hyphens are alike: `distCoeffs` is `dist_coeffs`.

    Attributes:
        path: The file.

    Raises:
        CameraError: A key is given twice.
    """

    def __init__(self, path: Path, content: dict[str, Any]) -> None:
        self.path = path
        self._spelling: dict[str, str] = {}
        self._values: dict[str, Any] = {}
        self._left: dict[str, str] = {}
        for key, value in content.items():
            if (plain := _plain(key)) in self._values:
                raise CameraError(f"{path}: '{self._spelling[plain]}' and '{key}' are the same key")
            self._spelling[plain] = self._left[plain] = key
            self._values[plain] = value

    @classmethod
    def read(cls, path: Path) -> Entries:
        """The mapping that is a whole YAML file; raises CameraError."""
        return cls(path, read_yaml_mapping(path, CameraError))

    def has(self, *names: str) -> bool:
        """Whether one of these keys is there."""
        return any(_plain(name) in self._values for name in names)

    def get(self, *names: str, default: Any = None) -> Any:
        """The value of the one that is there of several names for the same thing.

        Raises:
            CameraError: There are two, or none but a key that is nearly one of them.
        """
        given = [name for name in names if self.has(name)]
        if len(given) > 1:
            raise CameraError(f"{self.path}: '{given[0]}' and '{given[1]}' are both given")
        if not given:
            for name in (name for name in names if "." not in name):  # ORB-SLAM's differ by a letter
                for near in difflib.get_close_matches(_plain(name), self._left, 1, CLOSE):
                    raise CameraError(f"{self.path}: '{self._left[near]}' is not understood; the nearest is '{name}'")
            return default
        self._left.pop(_plain(given[0]), None)
        return self._values[_plain(given[0])]

    def numbers(self, *names: str, count: int | None = None) -> list[float]:
        """A number, a list, a list of rows, or a matrix mapping; raises CameraError where it is missing or none."""
        value = self.get(*names)
        if value is None and not self.has(*names):
            raise CameraError(f"{self.path}: '{names[0]}' is missing")
        if isinstance(value, dict):
            value = value.get("data")
        try:
            values = np.array(value, float).ravel()
        except (TypeError, ValueError):
            values = np.array([np.nan])
        if (
            value is None
            or isinstance(value, bool)
            or not np.isfinite(values).all()
            or count not in (None, len(values))
        ):
            name = next(name for name in names if self.has(name))
            raise CameraError(f"{self.path}: '{name}' should be {count or 'a list of'} number{'s' * (count != 1)}")
        return [float(number) for number in values]

    def number(self, *names: str) -> float:
        """One number; raises CameraError."""
        return self.numbers(*names, count=1)[0]

    def section(self, name: str) -> Entries:
        """The mapping below a key; raises CameraError where it is none."""
        value = self.get(name)
        if not isinstance(value, dict):
            raise CameraError(f"{self.path}: '{name}' should be a mapping")
        return Entries(self.path, {str(key): item for key, item in value.items()})

    def left(self, others: str) -> list[str]:
        """The keys that nobody has looked up, but for those that match `others`.

        Raises:
            CameraError: One speaks of the lens.
        """
        left = {plain: key for plain, key in self._left.items() if not re.fullmatch(others, plain)}
        for plain, key in left.items():
            if _LENS.fullmatch(plain):
                known = "distortion_model and distortion_coefficients"
                raise CameraError(f"{self.path}: '{key}' is not understood; a lens is described by {known}")
        return list(left.values())


def _plain(key: str) -> str:
    return re.sub(r"[_\-\s]", "", key).lower()
