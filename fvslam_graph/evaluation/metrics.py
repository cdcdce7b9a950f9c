"""Absolute and relative pose error with evo, drift and consistency: everything that is said about one trajectory."""

from __future__ import annotations

import io
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fvslam_graph.core.errors import TrajectoryError
from fvslam_graph.core.files import replacing, write_file, write_json, writing
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.association import SAME_INSTANT, TrajectoryPairs, associate
from fvslam_graph.evaluation.drift import LENGTHS, Drift, drift
from fvslam_graph.evaluation.nees import Consistency, consistency, relative_errors
from fvslam_graph.runs.results import Relatives
from fvslam_graph.runs.run_folder import METRICS_FILE, REFERENCE

MAX_COORDINATE = 1e9  # m, beyond the moon; squares of errors stay exact enough
MIN_MATCHED_SHARE = 0.5  # of the poses that could have a reference; fewer are worth a note

if TYPE_CHECKING:
    from evo.core.result import Result
    from evo.core.trajectory import PoseTrajectory3D


@dataclass(frozen=True)
class Evaluation:
    """How good an estimate is.

    Attributes:
        name: Of the estimate.
        alignment: The one that was used.
        pairs: Estimate and reference, pose by pose.
        poses: How many the estimate has.
        frames: How many images there were; None where that is not known.
        scale: Factor that brings the estimate to the size of the reference (Umeyama), whatever the alignment; NaN where
            the motion does not determine it.
        ape_scaled: RMSE of the positions after alignment with that factor, metres: what the shape alone errs.
        errors: evo's results, see `evaluate`; their statistics are in metres and degrees.
        drift: Of the estimate as it is.
        drift_scaled: After multiplication by `scale`.
        consistency: NEES of relative motions; None where there are no covariances.
        notes: What is missing or was done differently, and why; one sentence each.
        smoothed: RMSE of the positions of the smoothed trajectory after the same kind of alignment, metres; NaN where
            there is none.
    """

    name: str
    alignment: Alignment
    pairs: TrajectoryPairs
    poses: int
    frames: int | None
    scale: float
    ape_scaled: float
    errors: dict[str, Result]
    drift: Drift
    drift_scaled: Drift
    consistency: Consistency | None
    notes: tuple[str, ...]
    smoothed: float = math.nan

    def __repr__(self) -> str:
        ape, rpe = (self.errors[name].stats["rmse"] for name in ("ape_trans", "rpe_trans"))
        pairs = f"{len(self.pairs.indices)} of {self.poses} poses"
        return f"Evaluation({self.name!r}, {self.alignment}, APE {ape:.4g} m, RPE {rpe:.4g} m, {pairs})"

    def _repr_html_(self) -> str:
        from fvslam_graph.evaluation.report import facts_table

        return facts_table(self).html()

    @property
    def coverage(self) -> float | None:
        """Poses out / frames in."""
        return self.poses / self.frames if self.frames else None

    def summary(self) -> dict[str, Any]:
        """The content of metrics.json."""
        return {
            "name": self.name,
            "alignment": self.alignment.value,
            "association": "reference interpolated" if self.pairs.interpolated else "nearest stamps",
            "poses": self.poses,
            "frames": self.frames,
            "matched": len(self.pairs.indices),
            "coverage": self.coverage,
            "scale": self.scale,
            "ape_scaled": self.ape_scaled,
            "path_length": self.pairs.reference.path_length,
            **{name: result.stats for name, result in self.errors.items()},
            "ape_smoothed": self.smoothed,
            "drift": asdict(self.drift),
            "drift_scaled": asdict(self.drift_scaled),
            "nees": self.consistency and asdict(self.consistency),
            "notes": self.notes,
        }

    def write(self, folder: Path) -> None:
        """Write metrics.json, evo's result zips (`ape_trans.zip`, ...; see `evo_res`) and the associated reference.

        `evo_ape` and `evo_rpe` find the same numbers for `reference.tum` and the file of the estimate.

        Raises:
            ResultsError: The folder cannot be written.
        """
        from evo.tools.file_interface import save_res_file

        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            with replacing(folder / REFERENCE) as path:
                self.pairs.reference.write_tum(path)
            for name, result in self.errors.items():
                archive = io.BytesIO()
                save_res_file(archive, result)
                write_file(folder / f"{name}.zip", archive.getvalue())
            write_json(folder / METRICS_FILE, self.summary())


def evaluate(
    estimate: Trajectory,
    reference: Trajectory,
    align: Alignment = Alignment.SE3,
    name: str = "estimate",
    frames: int | None = None,
    relatives: Relatives | None = None,
    time_offset: float = 0.0,
) -> Evaluation:
    """Compare an estimate with a reference.

    The errors are: `ape_trans` (m) and `ape_rot` (deg), the absolute pose error; `rpe_trans` and `rpe_rot`, the
    relative pose error from pose to pose (evo: delta 1, unit f); `rpe_1m_trans` and `rpe_1m_rot`, the same over one
    metre of the reference's path (evo: delta 1, unit m, pairs from the reference). All pairs are consecutive.

    Args:
        estimate: world_T_camera.
        reference: world_T_camera, in a world of its own; the stamps need not be the same.
        align: Where the motion does not determine an SE(3) or Sim(3) alignment, ORIGIN takes its place, with a note.
        name: Of the estimate, in evo's results.
        frames: How many images there were.
        relatives: Motions between the poses of the estimate; NEES is over those that have a covariance.
        time_offset: Seconds, added to the stamps of the estimate to get those of the reference.

    Raises:
        TrajectoryError: Fewer than two poses have a reference, or positions are too far away for numbers.
    """
    pairs = associate(estimate, reference, time_offset)
    _require_near("estimate", pairs.estimate)
    _require_near("reference", pairs.reference)
    notes = [*estimate.notes, *reference.notes]
    if time_offset:
        notes.append(f"{time_offset:g} s are added to the stamps of the estimate")
    apart = float(np.abs(pairs.estimate.stamps - pairs.reference.stamps).max())
    if apart > SAME_INSTANT:
        notes.append(f"the stamps of estimate and reference are up to {1000 * apart:.2g} ms apart")
    if (matched := len(pairs.indices)) < MIN_MATCHED_SHARE * min(len(estimate), len(reference)):
        notes.append(f"only {matched} of {len(estimate)} poses have a reference: do both have the same clock and rate?")
    scale = _scale(pairs)
    determined = not math.isnan(scale)
    if not determined and align in (Alignment.SE3, Alignment.SIM3):
        notes.append(f"the motion does not determine an alignment by {align}: aligned at the origin")
        align = Alignment.ORIGIN

    errors = _errors(pairs, align, name)
    if "rpe_1m_trans" not in errors:
        notes.append("no relative pose error over 1 m: the path is shorter")

    matrices = pairs.estimate.matrices
    scaled = matrices.copy()
    scaled[:, :3, 3] *= scale
    if (length := pairs.reference.path_length) <= LENGTHS[0]:
        notes.append(f"no t_rel and r_rel: the path of {length:.1f} m is shorter than {LENGTHS[0]:.0f} m")

    consistent = None
    if relatives is not None:
        pose_errors, covariances = relative_errors(pairs, relatives, scale if align is Alignment.SIM3 else 1.0)
        consistent = consistency(pose_errors, covariances) if len(pose_errors) else None
    if consistent is None:
        notes.append("no NEES: no relative motion has a covariance and a reference")
    return Evaluation(
        name=name,
        alignment=align,
        pairs=pairs,
        poses=len(estimate),
        frames=frames,
        scale=scale,
        ape_scaled=_ape_scaled(pairs, name) if determined else math.nan,
        errors=errors,
        drift=drift(matrices, pairs.reference.matrices),
        drift_scaled=drift(scaled, pairs.reference.matrices),
        consistency=consistent,
        notes=tuple(notes),
    )


def _require_near(name: str, trajectory: Trajectory) -> None:
    farthest = float(np.abs(trajectory.positions).max())
    if farthest > MAX_COORDINATE:
        raise TrajectoryError(
            f"the {name} has a position {farthest:.3g} m away; more than {MAX_COORDINATE:g} m is no place"
        )


def _scale(pairs: TrajectoryPairs) -> float:
    """Umeyama's scale factor; NaN for degenerate motions."""
    from evo.core.geometry import GeometryException, umeyama_alignment

    try:
        _, _, scale = umeyama_alignment(pairs.estimate.positions.T, pairs.reference.positions.T, with_scale=True)
    except GeometryException:
        return math.nan
    return float(scale)


def _ape_scaled(pairs: TrajectoryPairs, name: str) -> float:
    from evo.core.metrics import PoseRelation
    from evo.main_ape import ape

    result = ape(*_evo_pair(pairs, name), PoseRelation.translation_part, **Alignment.SIM3.options)
    return float(result.stats["rmse"])


def _errors(pairs: TrajectoryPairs, align: Alignment, name: str) -> dict[str, Result]:
    from evo.core.filters import FilterException
    from evo.core.metrics import PoseRelation, Unit
    from evo.main_ape import ape
    from evo.main_rpe import rpe

    errors = {}
    for part, relation in (("trans", PoseRelation.translation_part), ("rot", PoseRelation.rotation_angle_deg)):
        errors[f"ape_{part}"] = ape(*_evo_pair(pairs, name), relation, **align.options)
        for key, unit in (("rpe", Unit.frames), ("rpe_1m", Unit.meters)):
            try:
                errors[f"{key}_{part}"] = rpe(
                    *_evo_pair(pairs, name),
                    relation,
                    delta=1.0,
                    delta_unit=unit,
                    pairs_from_reference=True,
                    **align.options,
                )
            except FilterException:  # no pair of poses is that far apart
                continue
    return errors


def _evo_pair(pairs: TrajectoryPairs, name: str) -> tuple[PoseTrajectory3D, PoseTrajectory3D]:
    """Fresh copies, since evo aligns in place; the names label its results."""
    reference, estimate = pairs.reference.to_evo(), pairs.estimate.to_evo()
    reference.name, estimate.name = "reference", name
    return reference, estimate
