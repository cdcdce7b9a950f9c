"""What a recording tells about itself and its camera: info, calibrate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Unpack

import typer

from fvslam_graph.cli.options import (
    CameraHeight,
    CameraPitch,
    Format,
    Fov,
    Frames,
    ImageTopic,
    SequencePath,
    Stride,
    Telemetry,
    TelemetryOffset,
)
from fvslam_graph.cli.terminal import show_facts

if TYPE_CHECKING:
    from fvslam_graph.sequences.board_calibration import BoardCalibration
    from fvslam_graph.sequences.open import SequenceOptions
    from fvslam_graph.vo.self_calibration import RecordingCalibration


def info(
    path: SequencePath,
    format: Format = None,
    camera_height: CameraHeight = None,
    camera_pitch: CameraPitch = None,
    topic: ImageTopic = None,
    fov: Fov = None,
    telemetry: Telemetry = None,
    telemetry_offset: TelemetryOffset = None,
) -> None:
    """Say what is recognised in a recording: format, frames, camera, ground truth, scale, gaps; topics of a bag."""
    from fvslam_graph.sequences.describe import describe
    from fvslam_graph.sequences.open import open_sequence, topics_of

    if topics := topics_of(path):  # also of a bag that does not open before a topic is chosen
        show_facts([("topic", f"{known.name}: {known.count} {known.type}") for known in topics])
    sequence = open_sequence(
        path,
        format=format,
        camera_height=camera_height,
        camera_pitch=camera_pitch,
        topic=topic,
        fov=fov,
        telemetry=telemetry,
        telemetry_offset=telemetry_offset,
    )
    show_facts(describe(sequence))


def calibrate(
    path: Annotated[str, typer.Argument(help="Recording, or folder of images or video of a board.")],
    checkerboard: Annotated[
        str | None, typer.Option(help="Inner corners of a checkerboard, as 9x6.", metavar="COLUMNSxROWS")
    ] = None,
    charuco: Annotated[
        str | None, typer.Option(help="Squares of a ChArUco board, as 7x5.", metavar="COLUMNSxROWS")
    ] = None,
    square: Annotated[float | None, typer.Option(help="Side of the squares of a board.", metavar="METRES")] = None,
    marker: Annotated[
        float | None, typer.Option(help="Side of the markers of a ChArUco board.", metavar="METRES")
    ] = None,
    frames: Frames = None,
    stride: Stride = 1,
    topic: ImageTopic = None,
    fov: Fov = None,
    out: Annotated[Path, typer.Option(help="Calibration to write.")] = Path("camera.yaml"),
) -> None:
    """Calibrate a camera by a board, or by a recording that has a rough calibration: what this has left in the images.

    Focal lengths, principal point and distortion, with standard deviations. By a recording, only what is certain is
    corrected; `run --recalibration` takes it out. By a board, there is a picture of the residuals as well.
    """
    from fvslam_graph.core.errors import CameraError
    from fvslam_graph.core.files import writing
    from fvslam_graph.sequences.camera_file import parameters, write_camera

    if not out.name:
        raise CameraError(f"--out takes the name of a file, not '{out}'")
    picture = out.with_name(f"{out.stem}_residuals.png")
    with writing(out.parent):  # a name may be too long even to ask
        if existing := [file for file in (out, picture) if file.exists()]:
            raise CameraError(f"{existing[0]} exists and is not overwritten; give another name by --out")
    board = None
    if (checkerboard, charuco, square, marker) != (None,) * 4:
        if (frames, topic, fov) != (None,) * 3 or stride != 1:
            raise CameraError("--frames, --stride, --topic and --fov are for a recording, not for a board")
        board = _by_board(Path(path), checkerboard, charuco, square, marker)
    calibration = board or _by_recording(path, frames=frames, stride=stride, topic=topic, fov=fov)
    write_camera(out, calibration.camera, calibration.sigmas, calibration.origin)
    for name, (value, sigma) in parameters(calibration.camera, calibration.sigmas).items():
        typer.echo(f"{name} = {value:.5g} +- {sigma:.2g}")
    typer.echo(f"by {calibration.origin}; {out}")
    if board is not None:
        from fvslam_graph.evaluation.plots.calibration import plot_residuals

        plot_residuals(board, picture)
        typer.echo(f"residuals: {picture}")


def _by_recording(path: str, **options: Unpack[SequenceOptions]) -> RecordingCalibration:
    from fvslam_graph.sequences.open import open_sequence
    from fvslam_graph.vo.self_calibration import calibrate_by_tracks

    return calibrate_by_tracks(open_sequence(path, **options))


def _by_board(
    path: Path, checkerboard: str | None, charuco: str | None, square: float | None, marker: float | None
) -> BoardCalibration:
    from fvslam_graph.core.errors import CameraError
    from fvslam_graph.core.extras import require
    from fvslam_graph.sequences import boards
    from fvslam_graph.sequences.board_calibration import calibrate

    require("eval")  # for the picture
    if checkerboard is not None and square is not None and charuco is None and marker is None:
        board = boards.checkerboard(checkerboard, square)
    elif charuco is not None and square is not None and checkerboard is None and marker is not None:
        board = boards.charuco(charuco, square, marker)
    else:
        raise CameraError("a board is --checkerboard with --square, or --charuco with --square and --marker")
    return calibrate(path, *boards.find_board(path, board))
