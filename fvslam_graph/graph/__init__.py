"""The factor graph: motions of odometry and landmarks of visual SLAM, smoothed together."""
