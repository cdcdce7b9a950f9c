"""Monocular visual odometry, EKF visual SLAM and their fusion, side by side and measured."""

__version__ = "0.1.0"
