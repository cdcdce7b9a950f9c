"""Sequences of the synthetic worlds: rendered images with exact ground truth, calibration and height."""

from __future__ import annotations

import difflib
import re
from typing import Annotated, Any, Protocol
from urllib.parse import parse_qsl

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from fvslam_graph.core.camera import Camera, Image
from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.sequence import Sequence
from fvslam_graph.simulation.worlds.drive import DriveWorld
from fvslam_graph.simulation.worlds.effects import Effects
from fvslam_graph.simulation.worlds.manoeuvres import Manoeuvre
from fvslam_graph.simulation.worlds.motion import RATE, Motion
from fvslam_graph.simulation.worlds.ripmap import Grey
from fvslam_graph.simulation.worlds.uav import UavWorld, View

FORMAT = "synthetic"
Side = Annotated[int, Field(ge=32, le=4096)]
Size = tuple[Side, Side]
EXAMPLE = "synthetic:uav?seed=3&frames=100"


class _Options(BaseModel):
    """The options of both worlds; `synthetic:WORLD?name=value&...` sets them."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    seed: int = Field(0, ge=0)
    frames: int = Field(200, ge=1, le=10_000)
    size: Size  # pixels, WIDTHxHEIGHT
    noise: float = Field(2.0, ge=0)  # grey values, standard deviation
    blur: float = Field(0.0, ge=0, le=1)  # exposure time as a share of the frame interval
    exposure: float = Field(0.0, ge=0, le=1)  # relative changes of brightness
    movers: int = Field(0, ge=0, le=8)  # moving cars
    drop: float = Field(0.0, ge=0, lt=1)  # share of the images that are lost

    @field_validator("size", mode="before")
    @classmethod
    def _split(cls, size: Any) -> Any:
        if not isinstance(size, str):
            return size
        if not re.fullmatch(r"\d+x\d+", size):
            raise ValueError("it is written WIDTHxHEIGHT, such as 640x480")
        return size.split("x")

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last."""
        return (self.frames - 1) / RATE


class UavOptions(_Options):
    """Options of `synthetic:uav`."""

    size: Size = (640, 480)
    camera: View = "downward"
    manoeuvre: Manoeuvre | None = None  # in place of a flight that weaves and climbs


class DriveOptions(_Options):
    """Options of `synthetic:drive`."""

    size: Size = (1242, 375)


class World(Protocol):
    """A world that can be rendered."""

    camera: Camera
    motion: Motion
    height_source: str

    def render(self, time: float) -> Grey:
        """The image (H, W), grey values, at `time` in seconds."""


_OPTIONS: dict[str, type[_Options]] = {"uav": UavOptions, "drive": DriveOptions}


def open_synthetic(name: str) -> Sequence:
    """The sequence of a synthetic world by its name, such as `synthetic:uav?seed=3&frames=100`.

    Raises:
        SequenceError: There is no such world or option, or a value is out of its range.
    """
    world, _, query = name.removeprefix("synthetic:").partition("?")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError:
        raise SequenceError(f"{name}: options are written name=value and joined by &, as in {EXAMPLE}") from None
    options = dict(pairs)
    if len(options) < len(pairs):
        raise SequenceError(f"{name}: an option is given twice")
    return synthetic_sequence(world, name, **options)


def synthetic_sequence(world: str, name: str | None = None, /, **options: Any) -> Sequence:
    """The sequence of a synthetic world with options as keyword arguments.

    The world frame of the ground truth is the first camera frame; the ground is the mean plane of the terrain or the
    road. Nothing is rendered before an image is asked for, and any image can be asked for in any order.

    Args:
        world: "uav" or "drive".
        name: Of the sequence; `synthetic:WORLD` where not given.
        options: As in UavOptions and DriveOptions.

    Raises:
        SequenceError: There is no such world or option, or a value is out of its range.
    """
    name = name or f"synthetic:{world}"
    if world not in _OPTIONS:
        raise SequenceError(f"{name}: there is no synthetic world '{world}', only {' and '.join(_OPTIONS)}")
    try:
        chosen = _OPTIONS[world].model_validate(options)
    except ValidationError as error:
        raise SequenceError(f"{name}: {_explain(error, list(_OPTIONS[world].model_fields))}") from None
    place = _build(chosen)
    stamps = np.arange(chosen.frames) / RATE
    effects = Effects(stamps, 1 / RATE, chosen.noise, chosen.blur, chosen.exposure, chosen.drop, chosen.seed)
    dropped = effects.dropped()

    def load(index: int) -> Image | None:
        return None if index in dropped else effects.apply(index, place.render)

    return Sequence(
        name=name,
        format=FORMAT,
        camera=place.camera,
        stamps=stamps,
        load=load,
        ground_truth=place.motion.trajectory(stamps).from_origin(),
        ground=place.motion.ground(stamps, place.height_source),
        notes=(f"{len(dropped)} of {len(stamps)} images are lost on purpose",) if len(dropped) else (),
    )


def _build(options: _Options) -> World:
    if isinstance(options, UavOptions):
        return UavWorld(options.size, options.camera, options.duration, options.movers, options.seed, options.manoeuvre)
    return DriveWorld(options.size, options.duration, options.movers, options.seed)


def _explain(error: ValidationError, names: list[str]) -> str:
    complaint = error.errors()[0]
    option = str(complaint["loc"][0])
    if complaint["type"] == "extra_forbidden":
        nearest = difflib.get_close_matches(option, names, 1, 0)[0]
        return f"there is no option '{option}'; the nearest is '{nearest}', and all are {', '.join(names)}"
    reason = complaint["msg"].removeprefix("Value error, ")
    return f"the option {option} cannot be '{complaint['input']}': {reason[0].lower()}{reason[1:]}"
