"""EKF visual SLAM: a camera-centred filter with landmarks in inverse depth."""
