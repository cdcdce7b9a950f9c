"""What a recording tells about itself and its camera: info, calibrate, distortion."""

from pathlib import Path
from typing import Annotated

import typer

from fvslam_graph.cli.options import (
    CameraHeight,
    CameraK1,
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
    path: Annotated[Path, typer.Argument(help="Folder of images of a board, or a video of it.")],
    square: Annotated[float, typer.Option(help="Side of the squares.", metavar="METRES")],
    checkerboard: Annotated[
        str | None, typer.Option(help="Inner corners of a checkerboard, as 9x6.", metavar="COLUMNSxROWS")
    ] = None,
    charuco: Annotated[
        str | None, typer.Option(help="Squares of a ChArUco board, as 7x5.", metavar="COLUMNSxROWS")
    ] = None,
    marker: Annotated[
        float | None, typer.Option(help="Side of the markers of a ChArUco board.", metavar="METRES")
    ] = None,
    out: Annotated[Path, typer.Option(help="Calibration to write, with a picture beside it.")] = Path("camera.yaml"),
) -> None:
    """Calibrate a camera by a board: focal lengths, principal point and distortion, with standard deviations.

    For what is left without a board, see `distortion`.
    """
    from fvslam_graph.core.errors import CameraError
    from fvslam_graph.core.extras import require
    from fvslam_graph.core.files import writing
    from fvslam_graph.evaluation.plots.calibration import plot_residuals
    from fvslam_graph.sequences import boards
    from fvslam_graph.sequences.board_calibration import calibrate as calibrated

    require("eval")  # for the picture
    if not out.name:
        raise CameraError(f"--out takes the name of a file, not '{out}'")
    picture = out.with_name(f"{out.stem}_residuals.png")
    with writing(out.parent):  # a name may be too long even to ask
        if existing := [file for file in (out, picture) if file.exists()]:
            raise CameraError(f"{existing[0]} exists and is not overwritten; give another name by --out")
    if checkerboard is not None and charuco is None and marker is None:
        board = boards.checkerboard(checkerboard, square)
    elif charuco is not None and checkerboard is None and marker is not None:
        board = boards.charuco(charuco, square, marker)
    else:
        raise CameraError("give --checkerboard, or --charuco with --marker")
    calibration = calibrated(path, *boards.find_board(path, board))
    calibration.write(out)
    plot_residuals(calibration, picture)
    for name, (value, sigma) in calibration.parameters().items():
        typer.echo(f"{name} = {value:.5g} +- {sigma:.2g}")
    typer.echo(f"{len(calibration.views)} views, {calibration.rms:.3f} pixels root mean square; {out}, {picture}")


def distortion(
    path: SequencePath,
    frames: Frames = None,
    stride: Stride = 1,
    camera_k1: CameraK1 = None,
    topic: ImageTopic = None,
    fov: Fov = None,
) -> None:
    """Measure the radial distortion (k1) that the calibration has left in the images, by tracks of odometry.

    It shows where the camera turns; `run --camera-k1` takes it out.
    """
    from fvslam_graph.sequences.open import open_sequence
    from fvslam_graph.vo.distortion import measure_distortion

    sequence = open_sequence(path, frames=frames, stride=stride, camera_k1=camera_k1, topic=topic, fov=fov)
    k1, sigma = measure_distortion(sequence)
    typer.echo(f"k1 = {k1:.4f} +- {sigma:.4f} (standard deviation)")
