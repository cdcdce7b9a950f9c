"""Recordings, one file per format, and the synthetic worlds."""
