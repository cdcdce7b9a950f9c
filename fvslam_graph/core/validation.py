"""Tells what is wrong with a declaration that pydantic refuses, in one sentence."""

from __future__ import annotations

import difflib
from typing import get_args

from pydantic import BaseModel, ValidationError


def complaint(error: ValidationError, model: type[BaseModel], kind: str) -> str:
    """The first complaint; an unknown name gets the nearest valid one.

    Args:
        error: What pydantic raised.
        model: What was validated.
        kind: What its fields are called, such as "setting".
    """
    first = error.errors()[0]
    name = ".".join(map(str, first["loc"]))
    if first["type"] == "extra_forbidden":
        nearest = difflib.get_close_matches(name, names(model), 1, 0)[0]
        return f"there is no {kind} '{name}'; the nearest is '{nearest}'"
    if first["type"] == "missing":
        return f"the {kind} '{name}' is missing"
    if first["type"] == "model_type":
        return f"'{name}' is a group of {kind}s and cannot be {first['input']!r}; set {name}.NAME"
    return f"the {kind} '{name}' cannot be {first['input']!r}: {first['msg'].removeprefix('Value error, ').lower()}"


def names(model: type[BaseModel], prefix: str = "") -> list[str]:
    """All names that can be set, those of groups as group.name."""
    found = []
    for name, field in model.model_fields.items():
        inner = next((part for part in (field.annotation, *get_args(field.annotation)) if _is_model(part)), None)
        found += [prefix + name] if inner is None else names(inner, f"{prefix}{name}.")
    return found


def _is_model(kind: object) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)
