"""Run visual odometry on a sequence and see how good it is. Takes a folder, a video or a synthetic world."""

import sys

import numpy as np

import fvslam_graph

sequence = sys.argv[1] if len(sys.argv) > 1 else "synthetic:uav?frames=40"
run = fvslam_graph.run(sequence, mode="vo", settings={"features.count": 300}, seed=1)
print(f"{len(run.online)} poses, {run.online.path_length:.1f} m, scale from {run.info['scale_source']}")
print(f"{np.median(run.frames['inliers']):.0f} inliers in the median frame")

if run.ground_truth is not None:
    evaluation = fvslam_graph.evaluate(run, align="sim3")
    print(f"APE {evaluation.errors['ape_trans'].stats['rmse']:.3f} m, scale off by {evaluation.scale - 1:+.2%}")
    print(f"NEES {evaluation.consistency.mean:.1f}, 6 is consistent")
