"""The words that all parts speak: cameras, trajectories, poses with covariances, frames, settings, errors."""
