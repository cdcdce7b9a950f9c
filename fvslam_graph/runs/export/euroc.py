"""The ASL layout of EuRoC's ground truth: `mav0/state_groundtruth_estimate0`, which has no covariances."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fvslam_graph.runs.export.poses import ExportedPoses

FOLDER = Path("mav0") / "state_groundtruth_estimate0"
# Velocities and biases, which follow in EuRoC's own files, are not estimated.
HEADER = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
SENSOR = """\
# The body S is the camera: x right, y down, z forward. R is the first camera.
sensor_type: visual-inertial
comment: estimated by fvslam_graph
T_BS:
  cols: 4
  rows: 4
  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
"""


def write(path: Path, poses: ExportedPoses) -> tuple[str, ...]:
    """Write stamps (ns), positions (m) and quaternions w, x, y, z of the camera as data.csv, beside its sensor.yaml."""
    folder = path / FOLDER
    folder.mkdir(parents=True)
    numbers = np.hstack([poses.trajectory.positions, poses.quaternions[:, [3, 0, 1, 2]]])
    lines = [
        f"{stamp},{','.join(f'{number:.17g}' for number in row)}"
        for stamp, row in zip(poses.nanoseconds, numbers, strict=True)
    ]
    (folder / "data.csv").write_text("\n".join([HEADER, *lines]) + "\n")
    (folder / "sensor.yaml").write_text(SENSOR)
    return ()
