"""Visual odometry: the relative pose of every frame, with its metric scale."""
