"""Show on a generated flight what the package does."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Annotated

import typer

from fvslam_graph.cli.run import run_into_folder
from fvslam_graph.cli.terminal import show, show_table
from fvslam_graph.core.choices import Mode
from fvslam_graph.evaluation.alignment import Alignment


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the runs.")] = Path("runs") / "demo",
    frames: Annotated[int, typer.Option(help="Length of the flight.", min=10)] = 200,
) -> None:
    """Fly a small UAV over generated terrain, estimate its motion in all modes, and compare."""
    from fvslam_graph.core.config import load_config
    from fvslam_graph.core.extras import require
    from fvslam_graph.evaluation.plots.runs import plot_runs
    from fvslam_graph.evaluation.report import runs_table, scale_sentence
    from fvslam_graph.evaluation.runs import evaluate_run
    from fvslam_graph.runs.run_folder import read_run
    from fvslam_graph.sequences.open import open_sequence

    require("eval")
    sequence = open_sequence(f"synthetic:uav?frames={frames}")
    sequence = replace(sequence, load=cache(sequence.load))  # rendering an image takes longer than using it
    evaluations = {}
    for mode, preset in (*((mode, "tuned") for mode in Mode), (Mode.AVERAGE, "paper")):
        name = f"{mode}-{preset}"
        typer.echo(f"{name}: {run_into_folder(sequence, load_config(preset, settings=[f'mode={mode}']), out / name)}")
        evaluations[name] = evaluate_run(out / name, align=Alignment.SE3)
    folders = [out / name for name in evaluations]
    plot_runs([read_run(folder) for folder in folders], out / "plots", Alignment.SE3)
    show_table(runs_table(folders))
    if sentence := scale_sentence(evaluations, "graph-tuned", ("vo-tuned", "vslam-tuned")):
        show(sentence)
    typer.echo(f"plots: {out / 'plots'}")
