"""Figures of runs on one sequence: paths, errors, drift, covariances, and what the estimator saw."""
