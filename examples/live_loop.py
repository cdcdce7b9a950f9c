"""Estimate poses while images come in, as from a camera; here they are rendered."""

import numpy as np

import fvslam_graph
from fvslam_graph.testing import rendered

camera_feed = rendered("uav", frames=20, size="320x240")
downward = fvslam_graph.Ground.below(pitch=np.pi / 2)
estimator = fvslam_graph.Estimator(camera_feed.camera, mode="graph", ground=downward, settings={"graph.lag": 3.0})

for frame in camera_feed:
    result = estimator.step(frame.image, frame.stamp, height=frame.height)
    x, y, z = result.pose.mean.translation()
    sigma = np.sqrt(np.trace(result.pose.covariance[3:, 3:]))
    print(f"{frame.stamp:.1f} s: {x:.2f} {y:.2f} {z:.2f} +- {sigma:.2f} m, {result.status}")

ending = estimator.finish()
print(f"smoothed: {ending.summary}")
