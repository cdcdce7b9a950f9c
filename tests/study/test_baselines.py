"""Other systems on real recordings beside ours; skipped where the recordings or the trajectories are absent."""

from pathlib import Path

import pandas as pd
import pytest
from evo.core.metrics import PoseRelation
from evo.main_ape import ape

from fvslam_graph.core.trajectory import Trajectory
from fvslam_graph.sequences.open import open_sequence
from fvslam_graph.study import run as module
from fvslam_graph.study.common_frames import nearest
from fvslam_graph.study.run import run_study
from fvslam_graph.study.spec import Study


def test_all_are_compared_on_the_same_frames_of_a_flight(real_data, tmp_path, monkeypatch):
    """ORB-SLAM3 has poses for 86 of 90 frames, DSO for 80; what evo finds on these 80 is what the table says."""
    recording, others = real_data("euroc_flight"), real_data("../baselines")
    monkeypatch.setattr(module, "draw_study", lambda *arguments: [])
    monkeypatch.setattr(module, "_draw_trajectories", lambda *arguments: [])
    files = {name: str(others / f"euroc_flight_{name}.tum") for name in ("orbslam3", "dso")}
    study = Study(sequences=[str(recording)], modes=["vo"], seeds=1, external={recording.name: files})
    table = run_study(study, tmp_path / "out", 1).table.set_index("mode")
    assert (table["coverage"] <= 1).all() and table["associated"].to_dict() == {"vo": 90, "orbslam3": 86, "dso": 80}
    assert set(table["common"]) == {80}

    sequence = open_sequence(recording)
    paths = {name: Trajectory.read(Path(path)) for name, path in files.items()}
    paths["vo"] = Trajectory.read(next((tmp_path / "out" / "runs").glob("*/trajectory_online.tum")))
    numbers = {name: nearest(path.stamps, sequence.stamps) for name, path in paths.items()}
    common = set.intersection(*(set(found.tolist()) for found in numbers.values()))
    truth = sequence.ground_truth.interpolate(sequence.stamps)
    for name, path in paths.items():
        kept = {number: row for row, number in enumerate(numbers[name]) if number in common}
        assert len(kept) == 80
        estimate = Trajectory(path.stamps[list(kept.values())], tuple(path.poses[row] for row in kept.values()))
        reference = Trajectory(truth.stamps[list(kept)], tuple(truth.poses[number] for number in kept))
        theirs = ape(
            reference.to_evo(), estimate.to_evo(), PoseRelation.translation_part, align=True, correct_scale=True
        )
        assert theirs.stats["rmse"] == pytest.approx(table.loc[name, "ape_common"], rel=1e-9)
    assert pd.notna(table["rpe_common"]).all()
