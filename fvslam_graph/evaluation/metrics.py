"""Absolute and relative pose error with evo, drift and consistency: everything that is said about one trajectory."""

from __future__ import annotations

import io
import logging
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fvslam_graph.core.errors import TrajectoryError
from fvslam_graph.core.extras import require
from fvslam_graph.core.files import replacing, write_file, write_json, writing
from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.evaluation.alignment import Alignment
from fvslam_graph.evaluation.association import SAME_INSTANT, TrajectoryPairs, associate
from fvslam_graph.evaluation.drift import LENGTHS, Drift, drift
from fvslam_graph.evaluation.motion_nees import motion_nees, unjudged
from fvslam_graph.evaluation.nees import Consistency, relative_errors
from fvslam_graph.evaluation.pose_errors import PoseErrors, Similarity, aligned
from fvslam_graph.evaluation.reference_quality import ReferenceQuality, reference_quality
from fvslam_graph.runs.results import Relatives
from fvslam_graph.runs.run_folder import METRICS_FILE, REFERENCE

_log = logging.getLogger(__name__)

MAX_COORDINATE = 1e9  # m, beyond the moon; squares of errors stay exact enough
MIN_ASSOCIATED_SHARE = 0.5  # of the poses that could have a reference; fewer are worth a note

if TYPE_CHECKING:
    from evo.core.result import Result


@dataclass(frozen=True)
class EstimateDetails:
    """What is known of an estimate besides its poses.

    Attributes:
        name: In evo's results.
        frames: How many images there were; None where that is not known.
        relatives: Motions between the poses of the estimate; NEES is over those that have a covariance.
    """

    name: str = "estimate"
    frames: int | None = None
    relatives: Relatives | None = None


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
        nees: NEES of relative motions: of the "pose", its "rotation" and the "direction" of its translation; empty
            where there are no covariances.
        reference: How good the reference is from frame to frame; None where no motions tell.
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
    nees: dict[str, Consistency]
    reference: ReferenceQuality | None
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

    @property
    def consistency(self) -> Consistency | None:
        """NEES of relative poses; None where there are no covariances."""
        return self.nees.get("pose")

    def summary(self) -> dict[str, Any]:
        """The content of metrics.json."""
        return {
            "name": self.name,
            "alignment": self.alignment.value,
            "association": "reference interpolated" if self.pairs.interpolated else "nearest stamps",
            "poses": self.poses,
            "frames": self.frames,
            "associated": len(self.pairs.indices),
            "coverage": self.coverage,
            "scale": self.scale,
            "ape_scaled": self.ape_scaled,
            "path_length": self.pairs.reference.path_length,
            **{name: result.stats for name, result in self.errors.items()},
            "ape_smoothed": self.smoothed,
            "drift": asdict(self.drift),
            "drift_scaled": asdict(self.drift_scaled),
            "nees": {part: asdict(nees) for part, nees in self.nees.items()},
            "reference": self.reference and asdict(self.reference),
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
    details: EstimateDetails | None = None,
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
        details: Of the estimate.
        time_offset: Seconds, added to the stamps of the estimate to get those of the reference.

    Raises:
        TrajectoryError: Fewer than two poses have a reference, or positions are too far away for numbers.
    """
    require("eval")
    details = details or EstimateDetails()
    _log.info("pairing %d poses with %d of the reference", len(estimate), len(reference))
    pairs = associate(estimate, reference, time_offset)
    _require_near("estimate", pairs.estimate)
    _require_near("reference", pairs.reference)
    notes = _association_notes(estimate, reference, pairs, time_offset)
    _log.info("aligning %d poses", len(pairs.indices))
    fit = Similarity.between(pairs)
    if fit is None and align in (Alignment.SE3, Alignment.SIM3):
        notes.append(f"the motion does not determine an alignment by {align}: aligned at the origin")
        align = Alignment.ORIGIN

    _log.info("comparing %d poses", len(pairs.indices))
    errors = PoseErrors(pairs, align, *aligned(pairs, align, fit), details.name).results()
    if "rpe_1m_trans" not in errors:
        notes.append("no relative pose error over 1 m: the path is shorter")
    if (length := pairs.reference.path_length) <= LENGTHS[0]:
        notes.append(f"no t_rel and r_rel: the path of {length:.1f} m is shorter than {LENGTHS[0]:.0f} m")

    scale = math.nan if fit is None else fit.scale
    nees, quality, doubts = _consistency(pairs, details.relatives, scale, align)
    return Evaluation(
        name=details.name,
        alignment=align,
        pairs=pairs,
        poses=len(estimate),
        frames=details.frames,
        scale=scale,
        ape_scaled=math.nan if fit is None else _ape_scaled(pairs, fit),
        errors=errors,
        drift=drift(pairs.estimate.matrices, pairs.reference.matrices),
        drift_scaled=drift(pairs.estimate.matrices, pairs.reference.matrices, scale),
        nees=nees,
        reference=quality,
        notes=(*notes, *doubts),
    )


def _consistency(
    pairs: TrajectoryPairs, relatives: Relatives | None, scale: float, align: Alignment
) -> tuple[dict[str, Consistency], ReferenceQuality | None, list[str]]:
    """The NEES of relative motions by what it is of, what the reference is like, and why it cannot judge some."""
    nees: dict[str, Consistency] = {}
    quality = None
    doubts = []
    if relatives is not None:
        quality = reference_quality(pairs, relatives, 1.0 if math.isnan(scale) else scale)
        nees = motion_nees(relative_errors(pairs, relatives, scale if align is Alignment.SIM3 else 1.0), quality)
        doubts = unjudged(quality, nees)
    if not nees:
        doubts.append("no NEES: no relative motion has a covariance and a reference")
    return nees, quality, doubts


def _association_notes(
    estimate: Trajectory, reference: Trajectory, pairs: TrajectoryPairs, time_offset: float
) -> list[str]:
    """What was done or looks odd about files and stamps."""
    notes = [*estimate.notes, *reference.notes]
    if time_offset:
        notes.append(f"{time_offset:g} s are added to the stamps of the estimate")
    apart = float(np.abs(pairs.estimate.stamps - pairs.reference.stamps).max())
    if apart > SAME_INSTANT:
        notes.append(f"the stamps of estimate and reference are up to {1000 * apart:.2g} ms apart")
    if (associated := len(pairs.indices)) < MIN_ASSOCIATED_SHARE * min(len(estimate), len(reference)):
        notes.append(
            f"only {associated} of {len(estimate)} poses have a reference: do both have the same clock and rate?"
        )
    return notes


def _require_near(name: str, trajectory: Trajectory) -> None:
    farthest = float(np.abs(trajectory.positions).max())
    if farthest > MAX_COORDINATE:
        raise TrajectoryError(
            f"the {name} has a position {farthest:.3g} m away; more than {MAX_COORDINATE:g} m is no place"
        )


def _ape_scaled(pairs: TrajectoryPairs, fit: Similarity) -> float:
    poses, _ = aligned(pairs, Alignment.SIM3, fit)
    squares = np.sum((poses[:, :3, 3] - pairs.reference.positions) ** 2, axis=1)
    return math.sqrt(squares.mean())
