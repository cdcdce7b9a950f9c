"""A grid of runs in parallel: the weight of V-SLAM in the paper's mean, over two worlds. Start it again: it goes on.

Takes a folder, the number of frames and how many processes, all of them or none.
"""

import sys
from pathlib import Path

from fvslam_graph.study.run import run_study
from fvslam_graph.study.spec import Study

# Processes import this file, so that what it does has to stand below this line.
if __name__ == "__main__":
    out, frames, workers = sys.argv[1:] or ["runs/grid_study", 30, 2]
    study = Study(
        name="Weight of V-SLAM",
        sequences=[f"synthetic:uav?frames={frames}", f"synthetic:drive?frames={frames}&size=621x188"],
        modes=["average"],
        settings={"fusion.weight": [0.0, 0.5, 1.0]},
        seeds=2,
    )
    outcome = run_study(study, Path(out), int(workers))
    print(outcome.table.pivot_table("ape", "variant", "sequence").round(4))
    print(f"everything, with plots: {out}/report.html")
