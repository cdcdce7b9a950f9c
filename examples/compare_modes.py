"""Compare odometry, the paper's mean and the factor graph on one sequence, over two seeds."""

import sys
from pathlib import Path

import fvslam_graph

sequence = sys.argv[1] if len(sys.argv) > 1 else "synthetic:uav?frames=40"
out = Path(sys.argv[2] if len(sys.argv) > 2 else "runs/compare_modes")
outcome = fvslam_graph.compare(sequence, modes=["vo", "average", "graph"], seeds=2, out=out)

print(outcome.summary().markdown())
medians = outcome.finished.groupby("mode")["ape"].median()
print(f"the best mode is {medians.idxmin()} with {medians.min():.3f} m")
print(f"everything, with plots: {out / 'report.html'}")
