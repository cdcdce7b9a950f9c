"""Options that several commands share, and what is made of their values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fvslam_graph.core.choices import Mode, Preset, ScaleSource
from fvslam_graph.core.errors import FvslamError
from fvslam_graph.evaluation.alignment import Alignment

if TYPE_CHECKING:
    from fvslam_graph.core.config import Config

SequencePath = Annotated[
    str,
    typer.Argument(
        metavar="PATH",
        help="Folder of KITTI, EuRoC, TUM, Karlsruhe or plain images, ROS bag, video, synthetic:uav, synthetic:drive.",
    ),
]
Format = Annotated[str | None, typer.Option(help="Of the recording, where it is not to be found out.")]
Frames = Annotated[str | None, typer.Option(help="Part of the sequence, START:STOP.", metavar="A:B")]
Stride = Annotated[int, typer.Option(help="Take every n-th frame.", min=1)]
CameraHeight = Annotated[float | None, typer.Option(help="Metres from the camera to the ground.")]
CameraPitch = Annotated[float | None, typer.Option(help="Radians that the camera looks below the horizon.")]
Recalibration = Annotated[
    Path | None, typer.Option(help="Calibration of the images once undistorted; see `calibrate`.", metavar="FILE")
]
ImageTopic = Annotated[str | None, typer.Option("--topic", help="Image topic of a ROS bag, if it holds several.")]
Fov = Annotated[float | None, typer.Option(help="Degrees that images without calibration are wide.")]
Telemetry = Annotated[
    Path | None,
    typer.Option(
        help="What a drone recorded: .srt or flight record (.csv); found beside a video if of the same name.",
        metavar="FILE",
    ),
]
TelemetryOffset = Annotated[
    float | None,
    typer.Option(help="Added to the times of the telemetry; estimated if not given.", metavar="SECONDS"),
]
ModeName = Annotated[
    str | None, typer.Option("--mode", help=f"{', '.join(Mode)}, or a path like mypkg:MyRule.", show_default="vo")
]
PresetName = Annotated[Preset | None, typer.Option(help="Settings to start from.", show_default="tuned")]
ConfigFile = Annotated[
    Path | None,
    typer.Option(help="YAML file with settings that differ from the preset, or config.yaml of a run to repeat."),
]
Scale = Annotated[ScaleSource | None, typer.Option(help="Where metres come from.", show_default="plane")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", help="One setting, e.g. scale.source=map. Repeatable.", metavar="K=V")
]
Seed = Annotated[int | None, typer.Option(help="Of all random numbers.", show_default="0")]
Rerun = Annotated[
    str | None,
    typer.Option(help="Show it in Rerun: a file to write, or `viewer` to look at once.", metavar="FILE.rrd|viewer"),
]
Align = Annotated[Alignment, typer.Option(help="How the estimate is brought into the world of its reference.")]


def chosen_config(
    preset: Preset | None, file: Path | None, options: Mapping[str, object], settings: list[str] | None
) -> Config:
    """Load the settings of a run: preset, file, options of their own by name where given, and those of `--set`."""
    from fvslam_graph.core.config import load_config

    given = [f"{name}={value}" for name, value in options.items() if value is not None]
    return load_config(preset, file, [*given, *(settings or [])])


def floats(text: str, option: str, form: str) -> list[float]:
    """Read numbers between spaces or commas; `form` is what the error says that the option takes."""
    try:
        return [float(number) for number in text.replace(",", " ").split()]
    except ValueError:
        raise FvslamError(f"{option} takes {form}, not '{text}'") from None
