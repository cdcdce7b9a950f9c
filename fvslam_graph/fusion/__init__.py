"""Fusion of visual odometry and visual SLAM."""
