"""A pose graph in g2o's text format, as GTSAM reads it: information in rad and m, along the axes of the camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.errors import ResultsError
from fvslam_graph.core.frame_result import G2O
from fvslam_graph.core.text_files import OWN_MAX_SIZE, read_text
from fvslam_graph.core.trajectory import pose_from_matrix
from fvslam_graph.runs.export.poses import ExportedPoses
from fvslam_graph.runs.results import Run

LEAST_SIGMA = 1e-6  # rad and m: what is told without any error, as by the scale source `unit`, is no number in g2o
_VERTEX, _EDGE = "VERTEX_SE3:QUAT", "EDGE_SE3:QUAT"


def write(path: Path, poses: ExportedPoses) -> tuple[str, ...]:
    """Write the poses, numbered by their frames, and the motions between them.

    The motions are those of the factor graph where the run has one, otherwise those from frame to frame.

    Raises:
        ResultsError: The run has no motions, since it did not come to its end.
    """
    run = poses.run
    vertices = np.hstack([poses.trajectory.positions, poses.quaternions])
    lines = [f"{_VERTEX} {frame} {_numbers(row)}" for frame, row in zip(poses.frames, vertices, strict=True)]
    frames = {str(frame) for frame in poses.frames}
    if run.folder is not None and (run.folder / G2O).exists():
        text = read_text(run.folder / G2O, ResultsError, OWN_MAX_SIZE)
        edges = [line for line in text.splitlines() if line.startswith(_EDGE)]
        note = "the motions are those of the factor graph"
    else:
        edges = _chain(run)
        note = "the motions are those from frame to frame, as the run has no factor graph"
    lines += [line for line in edges if frames.issuperset(line.split()[1:3])]
    path.write_text("\n".join(lines) + "\n")
    return (note,)


def _chain(run: Run) -> list[str]:
    """The relative motions of a run whose covariance is known, as edges."""
    if run.relatives is None:
        raise ResultsError(f"{run.name} did not come to its end and has no relative motions; run it again")
    edges = []
    for frame, (previous, matrix, covariance) in enumerate(
        zip(run.relatives.previous, run.relatives.prev_T_cur, run.relatives.covariances, strict=True)
    ):
        if previous == frame or not np.isfinite(covariance).all():
            continue
        motion, q = pose_from_matrix(matrix), pose_from_matrix(matrix).rotation().toQuaternion()
        information = _information(covariance)[np.triu_indices(6)]
        row = np.concatenate([motion.translation(), (q.x(), q.y(), q.z(), q.w()), information])
        edges.append(f"{_EDGE} {previous} {frame} {_numbers(row)}")
    return edges


def _information(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of a covariance (6, 6) in a pose's tangent, translation before rotation."""
    order = [3, 4, 5, 0, 1, 2]
    values, vectors = np.linalg.eigh(covariance[np.ix_(order, order)])
    information: NDArray[np.float64] = vectors / np.maximum(values, LEAST_SIGMA**2) @ vectors.T
    return information


def _numbers(row: NDArray[np.float64]) -> str:
    return " ".join(f"{number:.17g}" for number in row)
