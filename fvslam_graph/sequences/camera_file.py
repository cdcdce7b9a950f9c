"""A calibration that was estimated, as a file that is read again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.camera import Camera
from fvslam_graph.core.files import writing

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")


def parameters(camera: Camera, sigmas: NDArray[np.float64]) -> dict[str, tuple[float, float]]:
    """Value and standard deviation of each of PARAMETERS, of a camera with distortion k1 k2 p1 p2."""
    values = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.coefficients)
    return {name: (value, float(sigma)) for name, value, sigma in zip(PARAMETERS, values, sigmas, strict=True)}


def write_camera(path: Path, camera: Camera, sigmas: NDArray[np.float64], origin: str) -> None:
    """Write `camera.yaml`.

    Args:
        path: A file that does not exist yet.
        camera: With distortion k1 k2 p1 p2.
        sigmas: (8,) standard deviations of PARAMETERS.
        origin: What it was estimated by, one line.

    Raises:
        ResultsError: The file exists or cannot be written.
    """
    matrix = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    deviations = ", ".join(f"{name}: {sigma:.4g}" for name, (_, sigma) in parameters(camera, sigmas).items())
    text = (
        f"# By {origin}.\n"
        f"image_width: {camera.width}\nimage_height: {camera.height}\n"
        f"camera_matrix: [{', '.join(f'{value:.4f}' for value in matrix)}]\n"
        f"distortion_model: radtan\n"
        f"distortion_coefficients: [{', '.join(f'{value:.6f}' for value in camera.coefficients)}]\n"
        f"standard_deviations: {{{deviations}}}\n"
    )
    with writing(path.parent), path.open("x") as file:
        file.write(text)
